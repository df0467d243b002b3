cdef void turn(double[::1] x, Py_ssize_t q, double px, double py, double pz) noexcept nogil
cdef void turn_body(double[::1] x, Py_ssize_t q, double px, double py, double pz) noexcept nogil
cdef void unit(double[::1] x, Py_ssize_t q) noexcept nogil
cdef void matrix(double[::1] x, Py_ssize_t q, double[::1] w) noexcept nogil
cdef void originate(double[::1] x, double lat, double lon, double alt) noexcept nogil
cdef void move(double[::1] x, double[::1] k, double[::1] w, double dt) noexcept nogil
cdef void spread(double[::1] x, double[::1] k, double[::1] w, double dt) noexcept nogil
cdef void fade(double[::1] x, Py_ssize_t e, double g, double level) noexcept nogil
cdef void transition(double[::1] k, double[::1] w, double dt, Py_ssize_t first) noexcept nogil

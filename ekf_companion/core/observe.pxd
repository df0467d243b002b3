cdef void position(double[::1] x, double[::1] k, double[::1] w) noexcept nogil
cdef void height(double[::1] x, double[::1] k, double[::1] w) noexcept nogil
cdef Py_ssize_t velocity(double[::1] x, double[::1] k, double[::1] w) noexcept nogil
cdef void zero_velocity(double[::1] x, double[::1] w, double std) noexcept nogil
cdef bint azimuth(
    double[::1] x, double[::1] w, double bx, double by, double bz, double target, double std, double noise,
    bint has_iron
) noexcept nogil
cdef void pressure_altitude(double[::1] x, double[::1] w, double alt, double std) noexcept nogil
cdef double wrap(double angle) noexcept nogil
cdef void zero_rate(double[::1] x, double[::1] w, double std) noexcept nogil
cdef void blank(double[::1] w, Py_ssize_t m, double variance) noexcept nogil

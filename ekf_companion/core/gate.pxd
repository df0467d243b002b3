cdef void count(double[::1] x, Py_ssize_t aid, Py_ssize_t why) noexcept nogil
cdef bint fuse(double[::1] x, double[::1] k, double[::1] w, Py_ssize_t aid, Py_ssize_t m) noexcept nogil
cdef bint weigh(
    double[::1] x, double[::1] k, double[::1] w, Py_ssize_t aid, Py_ssize_t m, double nis
) noexcept nogil
cdef bint is_timed_out(double[::1] x, Py_ssize_t aid, double limit) noexcept nogil
cdef void announce(double[::1] x, double reason) noexcept nogil
cdef void settle(double[::1] x, Py_ssize_t aid) noexcept nogil
cdef void score(double[::1] x, double[::1] w, Py_ssize_t m, double nis, double gate) noexcept nogil

cdef void step(
    double[::1] x, double[::1] k, double[::1] w, double[:, ::1] rows, Py_ssize_t first, Py_ssize_t last
) noexcept nogil
cdef int describe(
    double[::1] x, double[::1] k, double[::1] y, double[::1] w, double[::1] out
) noexcept nogil
cdef bint is_sound(double[::1] x) noexcept nogil
cdef void recover(double[::1] x, double[::1] k, double[::1] good, double t) noexcept nogil

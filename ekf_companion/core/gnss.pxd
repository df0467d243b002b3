cdef bint take_fix(
    double[::1] x, double[::1] k, double[::1] w, double[:, ::1] rows, Py_ssize_t r
) noexcept nogil

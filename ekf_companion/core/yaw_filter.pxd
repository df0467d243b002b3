cdef void begin(
    double[::1] x, Py_ssize_t h, double vn, double ve, double variance, double bias, double delay
) noexcept nogil
cdef void know(double[::1] x, Py_ssize_t h, Py_ssize_t i, double value, double variance) noexcept nogil
cdef void predict(double[::1] x, double[::1] k, double[::1] w, Py_ssize_t h) noexcept nogil
cdef double judge(
    double[::1] x, double[::1] w, Py_ssize_t h, Py_ssize_t o, double vn, double ve, double variance
) noexcept nogil
cdef void absorb(double[::1] x, double[::1] w, Py_ssize_t h, Py_ssize_t o) noexcept nogil

cdef double innovate(double[::1] x, double[::1] w, Py_ssize_t m) noexcept nogil
cdef void absorb(double[::1] x, double[::1] w, Py_ssize_t m) noexcept nogil
cdef void absorb_yaw(double[::1] x, double[::1] w) noexcept nogil
cdef void forget(double[::1] x, Py_ssize_t first, Py_ssize_t count, double variance) noexcept nogil
cdef void soften(double[::1] w, Py_ssize_t m, double factor) noexcept nogil
cdef void inject(double[::1] x, double[::1] w) noexcept nogil
cdef void difference(double[::1] x, double[::1] y, double[::1] w) noexcept nogil
cdef void rebase(double[::1] y, double[::1] w) noexcept nogil

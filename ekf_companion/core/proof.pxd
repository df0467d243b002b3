cdef void forgive(double[::1] x, Py_ssize_t aid) noexcept nogil
cdef void add(double[::1] x, double[::1] w, Py_ssize_t aid, Py_ssize_t m) noexcept nogil
cdef bint is_given(double[::1] x, Py_ssize_t aid, Py_ssize_t m, double stated, double drift) noexcept nogil

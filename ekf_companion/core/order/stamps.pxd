cdef class Held:
    cdef Py_ssize_t capacity, size
    cdef long long[::1] t_ns
    cdef int[::1] kind
    cdef int[::1] result
    cdef double[:, ::1] values
    cdef bint add(self, long long t_ns, int kind, double[::1] values, int result) noexcept nogil
    cdef void remove(self, Py_ssize_t i) noexcept nogil

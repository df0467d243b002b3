cimport cython
@cython.locals(size=Py_ssize_t, n=Py_ssize_t, at=Py_ssize_t, start=Py_ssize_t, stop=Py_ssize_t, length=Py_ssize_t, tail=Py_ssize_t)
cpdef void join_lines(
    const unsigned char[::1] numbers, const unsigned char[::1] stamps,
    const unsigned char[::1] end, Py_ssize_t count,
    unsigned char[::1] out, long long[::1] places
)
cdef Py_ssize_t copy_known(
    const unsigned char[::1] numbers, Py_ssize_t start, Py_ssize_t stop,
    unsigned char[::1] out, Py_ssize_t n
) noexcept nogil

cimport cython
@cython.locals(end=Py_ssize_t, kind=int, size=int, last=Py_ssize_t)
cpdef tuple find_records(
    const unsigned char[::1] data, Py_ssize_t place, const int[:, ::1] sizes,
    long long[::1] counts, long long[::1] state, long long[:, ::1] found, Py_ssize_t n
)
@cython.locals(end=Py_ssize_t, size=int, after=Py_ssize_t, is_followed=bint)
cdef Py_ssize_t resume(const unsigned char[::1] data, Py_ssize_t place, const int[:, ::1] sizes) noexcept nogil

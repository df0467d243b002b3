cimport cython
@cython.locals(end=Py_ssize_t, size=Py_ssize_t, kind=int, is_known=bint, is_first_of_data=bint)
cpdef tuple find_definition(const unsigned char[::1] data, Py_ssize_t place, long long[::1] state)
@cython.locals(n=Py_ssize_t, size=Py_ssize_t, kind=int, after=Py_ssize_t, number=Py_ssize_t, synced=Py_ssize_t, is_known=bint)
cpdef tuple find_data(
    const unsigned char[::1] data, Py_ssize_t place, Py_ssize_t end, const int[:, ::1] sizes,
    long long[::1] state, long long[:, ::1] found
)
cdef Py_ssize_t size_of(const unsigned char[::1] data, Py_ssize_t place) noexcept nogil
cdef bint is_passed(int kind) noexcept nogil
@cython.locals(first=cython.uint, last=cython.uint)
cdef Py_ssize_t find_sync(const unsigned char[::1] data, Py_ssize_t place, Py_ssize_t end) noexcept nogil

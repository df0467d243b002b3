cimport cython
@cython.locals(
    size=Py_ssize_t, place=Py_ssize_t, n=Py_ssize_t, stop=Py_ssize_t, start=Py_ssize_t, row=Py_ssize_t,
    text=cython.p_char, line=cython.p_char, piece=bytes
)
cpdef write_messages(
    bytes numbers, list names, list ends, int channel, const long long[::1] stamp_ns, bytearray out,
    long long[::1] behind
)
@cython.locals(i=cython.int)
cdef void put_number(char* line, long long number) noexcept

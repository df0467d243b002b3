cimport cython
@cython.locals(
    size=Py_ssize_t, place=Py_ssize_t, n=Py_ssize_t, stop=Py_ssize_t,
    text=cython.p_char, line=cython.p_char, piece=bytes, out=bytearray
)
cpdef list name_numbers(bytes numbers, list names, list ends)

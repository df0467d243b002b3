cimport cython
ctypedef unsigned long long Stamp
@cython.locals(value=cython.uint)
cpdef void checksum_all(
    const unsigned char[::1] data, const unsigned short[::1] steps, unsigned short[::1] sums
)
@cython.locals(stamp=Stamp, good=bint)
cpdef tuple find_records(
    const unsigned char[::1] data, const unsigned short[::1] sums,
    const unsigned short[::1] steps, const unsigned short[:, ::1] moves,
    const short[::1] extras, long long[::1] state, long long[:, ::1] records, bint is_end
)
cdef Py_ssize_t frame_size(const unsigned char[::1] data, Py_ssize_t place, Py_ssize_t end) noexcept nogil
cdef Py_ssize_t message_id(const unsigned char[::1] data, Py_ssize_t place) noexcept nogil
cdef int seed(const unsigned char[::1] data, Py_ssize_t place, const short[::1] extras) noexcept nogil
@cython.locals(stamp=Stamp)
cdef Stamp stamp_at(const unsigned char[::1] data, Py_ssize_t start) noexcept nogil
@cython.locals(begun=cython.uint, value=cython.uint)
cdef bint is_whole(
    const unsigned char[::1] data, Py_ssize_t place, const unsigned short[::1] sums,
    const unsigned short[::1] steps, const unsigned short[:, ::1] moves, const short[::1] extras
) noexcept nogil
cdef bint is_near(Stamp stamp, Stamp other) noexcept nogil
cdef bint continues(const unsigned char[::1] data, Py_ssize_t start, Py_ssize_t end, Stamp stamp) noexcept nogil
cdef bint is_plausible(
    const unsigned char[::1] data, Py_ssize_t after, Py_ssize_t end, Stamp stamp, long long[::1] state
) noexcept nogil
cdef bint may_resume(
    const unsigned char[::1] data, Py_ssize_t place, Py_ssize_t end,
    const unsigned short[::1] sums, const unsigned short[::1] steps,
    const unsigned short[:, ::1] moves, const short[::1] extras, long long[::1] state
) noexcept nogil

cimport cython
from ekf_companion.mavlink.block cimport BlockReader
cdef class DatagramReader(BlockReader):
    cdef object layout, row_buffer, sender
    cdef long long changes
    cdef signed char[::1] kind_of
    cdef unsigned char[::1] extra_of
    cdef bint is_recording, is_open
    @cython.locals(end=cython.Py_ssize_t, number=cython.int, kind=cython.int)
    cpdef read_datagram(self, bytes data, object now_ns, object sender)
    @cython.locals(number=cython.int, kind=cython.int)
    cpdef bint may_wait(self, bytes data, object due_ns) except -1
    @cython.locals(size=cython.Py_ssize_t, number=cython.int)
    cdef int message_of(self, bytes data) noexcept
    cdef look_up(self)
    @cython.locals(
        ax=cython.double, ay=cython.double, az=cython.double,
        gx=cython.double, gy=cython.double, gz=cython.double,
        mx=cython.double, my=cython.double, mz=cython.double,
        pressure=cython.double, updated=cython.longlong, instance=cython.longlong, row=double[::1]
    )
    cdef fill(self, bytes payload)
    @cython.locals(i=cython.Py_ssize_t, j=cython.Py_ssize_t)
    cdef take_rows(self)
@cython.locals(crc=cython.uint, mixed=cython.uint, i=cython.Py_ssize_t)
cdef unsigned int checksum(bytes data, Py_ssize_t end, int extra) noexcept

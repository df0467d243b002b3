cimport cython
from ekf_companion.mavlink.payload cimport PayloadReader
from ekf_companion.mavlink.sequence cimport Sequence
cdef int BYTES, ANYBODYS, AUTOPILOTS, READ, PASSED, INERTIAL, ATTITUDE, TIMESYNC, FIX, POSITION
cdef int STX_2, HEADER_SIZE, SIGNED, HELD, HEARTBEAT_ID, ODOMETRY_ID
cdef long long LAST_US
cdef class Reader(PayloadReader):
    cdef object frames, sender
    cdef Sequence numbers
    cdef bytes piece
    cdef const unsigned char* data
    cdef long long[::1] start, end, stamp_us, received
    cdef int[::1] message_id
    cdef signed char[::1] kinds
    cdef bint is_open, is_yielding
    cdef long long changes
    cdef int peer_system, peer_component
    cdef look_at(self, bytes piece)
    cdef Py_ssize_t read_on(self, Py_ssize_t i) except -1
    cdef int kind_of(self, Py_ssize_t i) noexcept
    cdef bint is_from(self, Py_ssize_t place, int system, int component) noexcept
    cpdef read_datagram(self, bytes data, object now_ns, object sender)
    cpdef bint may_wait(self, bytes data, object due_ns) except -1
    @cython.locals(number=cython.int)
    cdef int message_of(self, bytes data) noexcept
    cdef look_up(self)
    cdef bint read_frame(
        self, int kind, Py_ssize_t place, Py_ssize_t end, int number, object now_ns
    ) except -1

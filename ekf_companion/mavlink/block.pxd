cimport cython
from ekf_companion.mavlink.block_rows cimport RowWriter
from ekf_companion.mavlink.decode.state cimport (
    ContextState, FieldState, HeadingState, InertialState, PositionState, PressureState
)
from ekf_companion.mavlink.sequence cimport Sequence
from ekf_companion.mavlink.timebase cimport Count, TimeBase
cdef class BlockReader(RowWriter):
    cdef readonly object frames
    cdef object session, kinds, decoder
    cdef ContextState context
    cdef InertialState imu
    cdef FieldState mag
    cdef PressureState baro
    cdef HeadingState heading
    cdef PositionState position
    cdef list pending
    cdef TimeBase clock
    cdef Count main
    cdef Sequence numbers
    cdef bint is_usable, is_yielding, is_idle, has_held, is_position_plain
    cdef long long peer_system, peer_component, our_system, our_component, imu_id
    cdef long long heard, believed, echoes, strangers, count, volume
    cdef double heading_std
    cdef long long[::1] heard_by_id, message_id, row, size_of, stamp_us, t_us
    cdef long long[::1] updated, instance, boot_ms, position_ms
    cdef signed char[::1] kind
    cdef unsigned char[::1] sequence, system, component, is_answer, target_system, target_component
    cdef double[::1] yaw
    cdef double[:, ::1] samples, positions
    cdef bint load(self, buffer) except -1
    cdef store(self)
    @cython.locals(kind=cython.int, number=cython.longlong)
    cdef Py_ssize_t read_on(self, Py_ssize_t i) except -1
    cdef bint read_message(self, int kind, Py_ssize_t i) except -1
    cdef hold(self, Py_ssize_t i)
    cdef free(self)
    @cython.locals(system=cython.int, component=cython.int)
    cdef bint read_timesync(self, Py_ssize_t k) except -1
    @cython.locals(stamp=cython.longlong, is_late=bint, is_due=bint, k=cython.Py_ssize_t)
    cdef bint read_attitude(self, Py_ssize_t i) except -1
    cdef bint is_near(self, long long stamp) except -1
    @cython.locals(
        stamp=cython.longlong, t_ns=cython.longlong, is_taken=bint, place=double[::1],
        k=cython.Py_ssize_t
    )
    cdef bint read_position(self, Py_ssize_t i) except -1
    cdef bint read_fix(self, Py_ssize_t i) except -1
    cdef write_heading(self, long long t_ns, double yaw)
    @cython.locals(
        t_us=cython.longlong, t_ns=cython.longlong, rank=cython.int, has_field=bint, is_zero=bint,
        has_pressure=bint,
        row=double[::1]
    )
    cdef bint read_inertial(self, Py_ssize_t k) except -1
    cdef bint can_read_field(self, double[::1] row) except -1
    @cython.locals(x=cython.double, y=cython.double, z=cython.double)
    cdef bint is_known(self, double[::1] row) except -1
    cdef bint can_read_pressure(self, double pressure) noexcept
    @cython.locals(t_ns=cython.longlong)
    cdef long long write_sample(self, long long t_us, double[::1] row) except? -1
    cdef write_field(self, long long t_ns, double[::1] row)
    cdef write_pressure(self, long long t_ns, double pressure)

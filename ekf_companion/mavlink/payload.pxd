cimport cython
from ekf_companion.mavlink.decode.fix cimport Fixes, GpsRawInt
from ekf_companion.mavlink.decode.state cimport (
    ContextState, DecoderState, FieldState, HeadingState, InertialState, PressureState, TrimState
)
from ekf_companion.mavlink.timebase cimport TimeBase
cdef int ACCEL_GYRO, MAG, PRESSURE, NORTH_CDEG
cdef Py_ssize_t ROOM, WIDTH
cdef long long LAST_US, BOOT_US, SLACK_US, NEAR_US, SURE_US, UNIX_FROM_US
cdef long long IMU_ROW, MAG_ROW, BARO_ROW, HEADING_ROW
cdef double WEAKEST, STRONGEST, LOWEST, HIGHEST, DEGREE, OF_AUTOPILOT
cdef packed struct HighresImu:
    unsigned long long time_usec
    float xacc, yacc, zacc, xgyro, ygyro, zgyro, xmag, ymag, zmag
    float abs_pressure, diff_pressure, pressure_alt, temperature
    unsigned short fields_updated
    unsigned char id
cdef packed struct Attitude:
    unsigned int time_boot_ms
    float roll, pitch, yaw, rollspeed, pitchspeed, yawspeed
cdef packed struct GlobalPositionInt:
    unsigned int time_boot_ms
    int lat, lon, alt, relative_alt
    short vx, vy, vz
    unsigned short hdg
cdef packed struct Timesync:
    long long tc1, ts1
    unsigned char target_system, target_component
cdef class PayloadReader:
    cdef object session, buffer, own, position
    cdef dict newest
    cdef DecoderState decoder
    cdef ContextState context
    cdef TrimState trim
    cdef InertialState imu
    cdef FieldState mag
    cdef PressureState baro
    cdef HeadingState heading
    cdef Fixes fixes
    cdef TimeBase clock
    cdef unsigned char[::1] payload
    cdef HighresImu[::1] sample
    cdef Attitude[::1] attitude
    cdef GpsRawInt[::1] fix
    cdef GlobalPositionInt[::1] place
    cdef Timesync[::1] timesync
    cdef long long[::1] out_t, out_kind
    cdef double[:, ::1] out
    cdef Py_ssize_t n, limit
    cdef int our_system, our_component, imu_id
    cdef double heading_std
    cdef bint is_idle
    cdef use(self, buffer)
    cdef Py_ssize_t begin_row(self, long long t_ns, long long kind) noexcept
    @cython.locals(i=cython.Py_ssize_t, j=cython.Py_ssize_t, t_ns=cython.longlong)
    cdef put_rows(self, list measurements)
    cdef put_vector(self, Py_ssize_t i, Py_ssize_t first, double x, double y, double z)
    cdef put_heading(self, long long t_ns, double heading)
    @cython.locals(i=cython.Py_ssize_t, j=cython.Py_ssize_t)
    cdef take_rows(self)
    cdef free(self)
    cdef bint read_timesync(self) except -1
    cdef bint is_near(self, long long stamp) except -1
    cdef advance(self, long long stamp, object now_ns)
    cdef bint read_attitude(self, object now_ns) except -1
    cdef bint read_position(self, bytes raw, object now_ns) except -1
    cdef bint read_fix(self) except -1
    @cython.locals(
        t_ns=cython.longlong, sampled=object, gx=cython.double, gy=cython.double, gz=cython.double,
        ax=cython.double, ay=cython.double, az=cython.double, mx=cython.double, my=cython.double,
        mz=cython.double, pressure=cython.double
    )
    cdef bint read_inertial(self) except -1
    @cython.locals(was_x=cython.double, was_y=cython.double, was_z=cython.double)
    cdef bint is_last(self, double x, double y, double z) except -1
    cdef bint can_read_field(self, double x, double y, double z) except -1
    cdef read_field(self, long long t_ns, double x, double y, double z)
    cdef bint can_read_pressure(self, double pressure) noexcept
    cdef read_pressure(self, long long t_ns, double pressure)
cdef void fill(
    unsigned char[::1] payload, const unsigned char* data, Py_ssize_t begin, Py_ssize_t size
) noexcept

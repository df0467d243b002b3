from ekf_companion.mavlink.decode.state cimport ContextState
cdef int UNKNOWN_16, NO_GPS, FIX_3D, NORTH_CDEG
cdef unsigned long long LAST_US
cdef double GEOID, RANGE_ERROR, STD_FLOOR, STD_UNKNOWN, STD_VEL, STD_YAW, STD_YAW_FLOOR
cdef packed struct GpsRawInt:
    unsigned long long time_usec
    int lat, lon, alt
    unsigned short eph, epv, vel, cog
    unsigned char fix_type, satellites_visible
    int alt_ellipsoid
    unsigned int h_acc, v_acc, vel_acc, hdg_acc
    unsigned short yaw
cdef class _Receiver:
    cdef object message, flags, newest_ns, velocities, yaw
    cdef list last
    cdef long long fixes
    cdef bint is_good, is_heard, has_fix
cdef class Fixes:
    cdef ContextState _context
    cdef _Receiver _first, _second
    cdef tuple _names
    cdef object _record, _unrelated_ns
    cdef GpsRawInt[::1] _said
    cdef public bint is_settled
    cdef public tuple std
    cdef list read_first(self, GpsRawInt m)
    cdef GpsRawInt _content(self, object frame) except *
    cdef list _read(self, _Receiver receiver, GpsRawInt m)
    cdef list _refuse(self, _Receiver receiver, object why)
    cdef object _refusal(self, _Receiver receiver, GpsRawInt m)
    cdef object _time(self, object message, unsigned long long stamp_us)
    cdef object _compare_heights(self, object message, GpsRawInt m)
    cdef object _fix(self, _Receiver receiver, GpsRawInt m, object t_ns)
    cdef object _note_velocity(self, object message, object why)
    cdef list _with_heading(self, _Receiver receiver, list fixes, GpsRawInt m)
cdef bint is_place(int lat_degE7, int lon_degE7) noexcept
cdef double dilution(int dop_100) noexcept
cdef double yaw_std(unsigned int hdg_acc_degE5) except -1

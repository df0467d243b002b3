cdef void restart(double[::1] x, double t) noexcept nogil
cdef void gather(double[::1] x) noexcept nogil
cdef void carry(double[::1] x, double[::1] w, double dt) noexcept nogil
cdef bint is_rest(double[::1] x, double[::1] k) noexcept nogil
cdef void level_at_rest(double[::1] x, double[::1] k, double[::1] w) noexcept nogil
cdef void level_roughly(double[::1] x, double[::1] k, double[::1] w) noexcept nogil
cdef bint level_in_motion(
    double[::1] x, double[::1] k, double[::1] w, double t, double vn, double ve, double vd, double std
) noexcept nogil
cdef bint level_again(
    double[::1] x, double[::1] k, double[::1] w, double t, double vn, double ve, double vd, double std
) noexcept nogil
cdef double turn_about(double[::1] x, double[::1] w, double dn, double de, double dd) noexcept nogil
cdef double find_down(
    double[::1] x, double[::1] k, double[::1] w, double t, double vn, double ve, double vd, double std
) noexcept nogil
cdef void begin_motion(double[::1] x, double t, double vn, double ve, double vd, double std) noexcept nogil
cdef void begin_filter(
    double[::1] x, double[::1] k, double[::1] w, double t, double tilt, double gyro_bias
) noexcept nogil

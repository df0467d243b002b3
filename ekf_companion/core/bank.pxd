cdef void begin(double[::1] x, double[::1] k) noexcept nogil
cdef void lose(double[::1] x) noexcept nogil
cdef void know_bias(double[::1] x, double std) noexcept nogil
cdef void carry(
    double[::1] x, double[::1] w, double dt, double gx, double gy, double gz, double ax, double ay, double az
) noexcept nogil
cdef void correct(double[::1] x, double[::1] k, double[::1] w, double vn, double ve, double std) noexcept nogil

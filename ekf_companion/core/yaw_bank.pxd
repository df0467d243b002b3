cdef void begin(double[::1] x, double[::1] k) noexcept nogil
cdef void know_bias(double[::1] x, double std) noexcept nogil
cdef void correct(double[::1] x, double[::1] k, double[::1] w, double vn, double ve, double std) noexcept nogil

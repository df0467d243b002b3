cdef void moved(double[::1] x, double[::1] k, double[::1] w, double dt) noexcept nogil
cdef void doubted(double[::1] x, double[::1] w) noexcept nogil
cdef void noted(double[::1] x, double[::1] w, bint is_sample) noexcept nogil

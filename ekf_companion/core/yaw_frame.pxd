cdef void lose(double[::1] x) noexcept nogil
cdef void carry(double[::1] x, double[::1] w, double dt) noexcept nogil
cdef void restart_sums(double[::1] x) noexcept nogil
cdef void stand_up(double[::1] x) noexcept nogil
cdef void antenna(double[::1] x, double[::1] k, double[::1] w) noexcept nogil

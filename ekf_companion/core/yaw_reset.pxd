cdef bint is_ready(double[::1] x) noexcept nogil
cdef double excess(double[::1] x) noexcept nogil
cdef bint agrees(double[::1] x) noexcept nogil
cdef bint is_needed(double[::1] x, double nis, double dt, double std) noexcept nogil
cdef void adopt(double[::1] x) noexcept nogil
cdef void record(double[::1] x) noexcept nogil
cdef double slow_error(double[::1] x, double stated) noexcept nogil

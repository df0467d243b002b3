cpdef void tell(double[::1] x, double[::1] out, double[::1] w, double[::1] told) noexcept nogil

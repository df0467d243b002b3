cdef bint is_heading_used(double[::1] x, double[::1] k, double t, double source) noexcept nogil
cdef bint is_field_used(double[::1] x, double[::1] k) noexcept nogil
cdef void take_heading(
    double[::1] x, double[::1] k, double[::1] w, double heading, double std, bint is_antenna
) noexcept nogil
cdef void take_field(
    double[::1] x, double[::1] k, double[::1] w, double mx, double my, double mz
) noexcept nogil
cdef void face(double[::1] x, double[::1] w) noexcept nogil

cdef void rotate(double *q, double px, double py, double pz) noexcept nogil
cdef void rotate_body(double *q, double px, double py, double pz) noexcept nogil
cdef void normalise(double *q) noexcept nogil
cdef void to_dcm(double *q, double C[3][3]) noexcept nogil
cdef double wrap(double angle) noexcept nogil

# Made from rotation.py by setup.py
from ekf_companion.core.memory cimport Dcm, Vector
cdef void rotate(Vector q, double px, double py, double pz) noexcept nogil
cdef void rotate_body(Vector q, double px, double py, double pz) noexcept nogil
cdef void normalise(Vector q) noexcept nogil
cdef void to_dcm(Vector q, double C[3][3]) noexcept nogil
cdef double wrap(double angle) noexcept nogil

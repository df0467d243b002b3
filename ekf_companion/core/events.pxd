from ekf_companion.core.scratch cimport Event
cdef int compare(Event *row, double t, int kind, double[::1] values) noexcept nogil
cdef bint is_sane(int kind, double[::1] values) noexcept nogil
cdef bint is_nowhere(double lat, double lon, int flags) noexcept nogil

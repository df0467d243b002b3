cimport cython
from ekf_companion.mavlink.decode.state cimport TrimState
cdef class RowWriter:
    cdef object buffer, values_of
    cdef TrimState trim
    cdef long long[::1] out_t, out_kind
    cdef double[:, ::1] out
    cdef Py_ssize_t n, limit
    cdef use(self, buffer)
    cdef void begin_row(self, long long t_ns, long long kind) noexcept
    cdef put_rows(self, measurements)
    cdef put_vector(self, double x, double y, double z, Py_ssize_t first)
    cdef put_sample(self, long long t_ns, double[::1] row)
    cdef put_field(self, long long t_ns, double[::1] row)
    cdef put_height(self, long long t_ns, double alt)
    cdef put_heading(self, long long t_ns, double heading, double std)
    @cython.locals(row=double[::1])
    cdef put_position(self, long long t_ns, double[::1] place, std)
cdef double radians(double degrees) noexcept

cimport cython


cdef class Repetition:
    cdef double[6] _last
    cdef long long[6] _runs
    cdef long long[6] _equal
    cdef long long _pairs, _since_us, _newest_us
    cdef public dict refused
    cpdef object judge_axes(
        self, long long t_us, double gx, double gy, double gz, double ax, double ay, double az
    )
    @cython.locals(n=Py_ssize_t, t_us=cython.longlong)
    cpdef object judge_each(
        self, const long long[::1] t_ns, const double[:, ::1] values, unsigned char[::1] is_good
    )
    cdef bint _count(self, int axis, double value) noexcept
    cdef bint _is_silent(self, int axis) noexcept
    cdef bint _may_stand(self, long long t_us)

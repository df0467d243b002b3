cdef class Repetition:
    cdef double[6] _last
    cdef long long[6] _runs
    cdef long long[6] _equal
    cdef long long _pairs, _since_us
    cpdef object judge_axes(
        self, long long t_us, double gx, double gy, double gz, double ax, double ay, double az
    )
    cdef bint _count(self, int axis, double value) noexcept
    cdef bint _is_silent(self, int axis) noexcept
    cdef bint _may_stand(self, long long t_us)

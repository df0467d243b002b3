cdef class _Challenger:
    cdef public object first_ns
    cdef public long long count, used, since
cdef class Preference:
    cdef public int rank, sole
    cdef double _starving
    cdef long long _used
    cdef object _waiting_ns
    cdef dict _challengers
    cpdef use(self, int rank)
    cpdef bint admit(self, int rank, object t_ns)
    cdef bint _is_steady(self, _Challenger one, object t_ns)
    cdef bint _is_needed(self, _Challenger one, object t_ns)
cdef class Pace:
    cdef object _last_ns, _period_ns
    cpdef bint is_due(self, object t_ns)
    cpdef bint admit(self, object t_ns)

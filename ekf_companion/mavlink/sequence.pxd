cdef class Sequence:
    cdef public long long lost, late, duplicate
    cdef object _last, _last_ns
    cpdef begin(self)
    cpdef count(self, long long number, object now_ns)
    cpdef count_unverified(self, long long number, object now_ns)

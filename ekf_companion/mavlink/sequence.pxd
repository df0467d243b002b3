cdef class Sequence:
    cdef public long long lost, late, duplicate
    cdef object _last, _last_ns, _again, _again_ns, _before, _gap
    cpdef begin(self)
    cpdef bint count(self, long long number, object now_ns, bint is_behind=*)
    cpdef note_again(self, long long number, object now_ns)
    cdef bint _is_again(self, long long number, long long gap, object now_ns)
    cpdef count_unverified(self, long long number, object now_ns)

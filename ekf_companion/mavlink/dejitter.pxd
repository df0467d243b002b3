cimport cython
cdef class Dejitter:
    cdef public bint is_active
    cdef public double period, spread
    cdef readonly long long _last
    cdef long long _half, _out, _grid, _cycles
    cdef double _per_cycle, _most, _near, _far, _variance, _least, _moved
    cdef bint _is_loop
    cdef int _left
    cdef long long _blocks
    cdef list _stamps, _lates
    cdef _learn_anew(self)
    cdef _begin_block(self)
    @cython.locals(now=cython.longlong, ahead=cython.longlong, cycles=cython.longlong, late=cython.double, out=cython.longlong)
    cpdef object smooth(self, long long stamp_us)
    cdef _take_period(self, double period, long long now, bint is_loop)
    cdef double _let_up(self, double late)
    cdef _settle(self)

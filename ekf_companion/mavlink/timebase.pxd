cdef class Count:
    cdef public object latest_us, step_us, doubt_us, behind_us, leap_us, leap_end_us
    cdef public object behind_at_us, leap_at_us, first_us, first_at_us
    cdef _begin(self, object stamp_us, object now_us)
    cdef bint _is_burst(self, object since_us, object now_us)
    cdef public bint is_doubtful
    cdef bint _is_doubt_last
    cpdef confirm(self)
    cpdef object take(self, object stamp_us, object now_us=*)
    cdef bint _is_confirmed(self, object stamp_us)
    cdef object _follow(self, object stamp_us, object step, object now_us)
cdef class TimeBase:
    cdef public Count main
    cdef Count _boot
    cdef object _unix_minus_boot_us, _held_relation_us, _boot_us, _next_boot_us
    cdef public bint is_behind
    cdef public object now_us
    cpdef confirm(self)
    cpdef bint follow(self, object stamp_us)
    cpdef object advance(self, object stamp_us)
    cpdef object advance_boot_ms(self, object boot_ms)
    cpdef object from_us(self, object stamp_us)
    cpdef object from_boot_ms(self, object boot_ms)

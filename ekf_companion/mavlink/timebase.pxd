cdef class Count:
    cdef public object latest_us, step_us, doubt_us, behind_us, leap_us, leap_end_us
    cpdef object take(self, object stamp_us)
    cdef bint _is_confirmed(self, object stamp_us)
    cdef object _follow(self, object stamp_us, object step)
cdef class TimeBase:
    cdef public Count main
    cdef Count _boot
    cdef object _unix_minus_boot_us, _held_relation_us
    cdef public bint is_behind
    cpdef bint follow(self, object stamp_us)
    cpdef object advance(self, object stamp_us)
    cpdef object advance_boot_ms(self, object boot_ms)
    cpdef object from_us(self, object stamp_us)
    cpdef object from_boot_ms(self, object boot_ms)

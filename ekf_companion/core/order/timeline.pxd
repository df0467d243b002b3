from ekf_companion.core.order.stamps cimport Held
from ekf_companion.core.memory.parameters cimport Parameters
from ekf_companion.core.memory.scratch cimport Event, Scratch
from ekf_companion.core.memory.state cimport State
cdef class Timeline:
    cdef double[:, ::1] table
    cdef double[:, ::1] snapshot_table
    cdef double[:, ::1] blocks
    cdef double[::1] parameters
    cdef double[::1] out
    cdef double[::1] numbers
    cdef float[::1] singles
    cdef double[::1] given
    cdef Py_ssize_t[::1] snapshot_row
    cdef long long[::1] delay
    cdef long long[:, ::1] counters
    cdef Event *rows
    cdef State *snapshots
    cdef State *x
    cdef State *y
    cdef State *first
    cdef State *mark
    cdef double[::1] late_last, late_next
    cdef Parameters *k
    cdef Scratch w
    cdef Held ahead, behind
    cdef Py_ssize_t size, capacity, cursor, snaps, mark_row, lost, stretch, behind_samples
    cdef double expected_t, window, newest, oldest, reach, interval, late_t, behind_t, behind_first
    cdef readonly long long epoch_ns, stamp_ns, reruns, reboots
    cdef long long rebooted_at, reason_before
    cdef bint has_epoch, is_restored, is_set, is_leaping, keeps
    cdef list gone
    cdef void clear(self) noexcept nogil
    cdef int restart(self) except -1 nogil
    cdef int reboot(self) except -1 nogil
    cdef long long last_reason(self) noexcept nogil
    cdef void begin_stretch(self) noexcept nogil
    cdef int set_clock(self, long long t_ns) except -1 nogil
    cpdef void restore(
        self, double[::1] block, double[:, ::1] waiting, long long epoch_ns, long long stamp_ns
    )
    cdef void begin_from(self, double t, long long t_ns) noexcept nogil
    cpdef int insert(self, long long t_ns, int kind, values) except -1
    cdef int put(self, long long t_ns, int kind, double[::1] values) except -1 nogil
    cdef int place(self, long long t_ns, int kind, double[::1] values) except -1 nogil
    cdef int fit(self, long long t_ns, double t, int kind, double[::1] values) except -1 nogil
    cdef void learn_interval(self, double step) noexcept nogil
    cdef double time_of(self, Held held, Py_ssize_t i) noexcept nogil
    cdef void recount(self, Held held, Py_ssize_t i, int result) noexcept nogil
    cdef bint has_room(self, double t) noexcept nogil
    cdef bint is_confirmed(self, double t) noexcept nogil
    cdef int hold(self, long long t_ns, double[::1] values) noexcept nogil
    cdef int release(self, double t) except -1 nogil
    cdef int settle(self, double t) except -1 nogil
    cdef Py_ssize_t earliest(self) noexcept nogil
    cdef int go_behind(
        self, long long t_ns, double t, double[::1] values, bint is_stale
    ) except -1 nogil
    cdef bint is_known(self, double t, double[::1] values) noexcept nogil
    cdef int follow_clock(self) except -1 with gil
    cdef int flush(self) except -1 nogil
    cdef void write_row(self, Py_ssize_t i, double t, int kind, double[::1] values) noexcept nogil
    cdef void expect_late(self, double t, int kind) noexcept nogil
    cdef void go_back(self, Py_ssize_t i) noexcept nogil
    cdef void run(self) noexcept nogil
    cdef int trim(self) except -1 nogil
    cpdef Py_ssize_t run_log(
        self, long long[::1] t_ns, long long[::1] kind, double[:, ::1] values,
        long long[::1] stamps, double[:, ::1] out
    ) except -1
    cdef int hand_over(self, Py_ssize_t count) except -1 nogil
    cdef int keep(self, Py_ssize_t count) except -1 with gil

from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport Event, Scratch
from ekf_companion.core.state cimport State
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
    cdef Parameters *k
    cdef Scratch w
    cdef Py_ssize_t size, capacity, cursor, snaps, lost, stretch
    cdef double window, newest, oldest
    cdef readonly long long epoch_ns, stamp_ns, reruns
    cdef bint has_epoch, is_restored, is_set, keeps
    cdef list gone
    cdef void clear(self)
    cpdef void restart(self)
    cdef void begin_stretch(self)
    cdef void set_clock(self, long long t_ns)
    cpdef void restore(
        self, double[::1] block, double[:, ::1] waiting, long long epoch_ns, long long stamp_ns
    )
    cdef void begin_from(self, double t, long long t_ns)
    cpdef int insert(self, long long t_ns, int kind, values) except -1
    cdef int put(self, long long t_ns, int kind, double[::1] values)
    cdef int place(self, long long t_ns, int kind, double[::1] values)
    cdef void write_row(self, Py_ssize_t i, double t, int kind, double[::1] values)
    cdef void go_back(self, Py_ssize_t i)
    cdef void run(self)
    cdef void trim(self)
    cpdef Py_ssize_t run_log(
        self, long long[::1] t_ns, long long[::1] kind, double[:, ::1] values,
        long long[::1] stamps, double[:, ::1] out
    ) except -1
    cdef void hand_over(self, Py_ssize_t count)

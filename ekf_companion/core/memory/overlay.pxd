# Structs laid over arrays of doubles
from libc.string cimport memcpy
from ekf_companion.core.memory.bank cimport Bank, Instance
from ekf_companion.core.memory.enums cimport N
from ekf_companion.core.memory.parameters cimport Parameters
from ekf_companion.core.memory.scratch cimport Estimate, Event, OdometryNumbers, TapeRecord
from ekf_companion.core.memory.state cimport ESTIMATED, State
ctypedef double *Vector
ctypedef double *Numbers  # a memoryview; the signature says so
ctypedef double (*Dcm)[3]
ctypedef double (*Square)[N]
ctypedef Event *Structs
cdef inline State *as_state(double[::1] block) noexcept nogil:
    return <State *> &block[0]
cdef inline State *as_states(double[:, ::1] blocks) noexcept nogil:
    return <State *> &blocks[0, 0]
cdef inline Parameters *as_parameters(double[::1] numbers) noexcept nogil:
    return <Parameters *> &numbers[0]
cdef inline Event *as_events(double[:, ::1] rows) noexcept nogil:
    return <Event *> &rows[0, 0]
cdef inline Estimate *as_estimate(double[::1] numbers) noexcept nogil:
    return <Estimate *> &numbers[0]
cdef inline OdometryNumbers *as_odometry(double[::1] numbers) noexcept nogil:
    return <OdometryNumbers *> &numbers[0]
cdef inline TapeRecord *as_records(double[:, ::1] records) noexcept nogil:
    return <TapeRecord *> &records[0, 0]
cdef inline Bank *as_banks(double[:, ::1] numbers) noexcept nogil:
    return <Bank *> &numbers[0, 0]
cdef inline Py_ssize_t bank_size(const Bank *bank) noexcept nogil:
    return ((<char *> &bank.instance[0] - <char *> bank) + bank.n * sizeof(Instance)) // 8
cdef inline void copy_bank(Bank *to, const Bank *source) noexcept nogil:
    memcpy(to, source, 8 * bank_size(source))
cdef inline double *columns_of(Bank *bank) noexcept nogil:
    return &bank.U[0][0][0]
cdef inline void copy_state(State *to, const State *source) noexcept nogil:
    to[0] = source[0]
cdef inline double *errors(State *x) noexcept nogil:
    return &x.vel_n[0]
cdef inline void clear_estimated(State *x) noexcept nogil:
    cdef double *numbers = <double *> x
    cdef Py_ssize_t i
    for i in range(ESTIMATED):
        numbers[i] = 0.0

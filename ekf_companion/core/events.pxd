# Made from events.py by setup.py
from ekf_companion.core.memory cimport Numbers
from ekf_companion.core.scratch cimport Event
cdef Py_ssize_t compare(Event *row, double t, Py_ssize_t kind, double[::1] values) noexcept nogil
cdef bint is_sane(Py_ssize_t kind, double[::1] values) noexcept nogil
cdef bint is_nowhere(double lat, double lon, Py_ssize_t flags) noexcept nogil

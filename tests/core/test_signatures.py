"""The headers that the compiler reads are made of what the sources say."""

import ast

import pytest

from ekf_companion.core.memory.signatures import compiled_modules, path_of, signatures

SOURCE = """
from cython.cimports.ekf_companion.core.memory.scratch import Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.memory.overlay import as_states
from ekf_companion.mavlink.decode.air import WEAKEST
from ekf_companion.mavlink.decode.inertial import Inertial
from ekf_companion.nav.arrays import Bytes, Column, Const, Table
_FAR, _NEAR = 1e300, range(3)
class Base:
    last: tuple[float, ...] | None
    imu: Inertial
class Queue(Base):
    def __init__(self, name: str, size: int) -> None:
        self.w, self._scales = Scratch(), [0.0] * 3
        self.name, self.size, self.x = name, size, as_states(np.zeros((9, 9)))
        self.rows = np.zeros((size, 4), dtype=np.int64)
        self.reach = _FAR
        self.last = ()
    def add(self, t_ns: int, data: Bytes, is_late: bool = False) -> int | None:
        place: cython.uint = 0
        return self._put(t_ns, 0.5)
    def _put(self, t_ns: int, by: float) -> bool:
        self._grow(self.x)
        return self._is_full(t_ns)
    def _grow(self, x: State) -> None:
        self.rows = np.zeros((9, 4))
    def _is_full(self, i: int) -> bool:
        return i >= self.size
    def each(self, *, by: int) -> None: ...
    def total(self, values: Column[np.float64]) -> float:
        return sum(value for value in values)
def difference(x: State, rows: Const[Table[np.int16]]) -> float: ...
def words(rows: list[float], other: str) -> tuple[float, float]: ...
"""
HEADER = """\
# Made from core.queue by setup.py
cimport cython
from ekf_companion.core.memory.scratch cimport Scratch
from ekf_companion.core.memory.state cimport State
from ekf_companion.mavlink.decode.state cimport InertialState
cdef double _FAR
cdef double WEAKEST
cdef class Base:
    cdef public tuple last
    cdef public InertialState imu
cdef class Queue(Base):
    cdef Scratch w
    cdef double _scales[3]
    cdef public object name
    cdef public cython.longlong size
    cdef State *x
    cdef cython.longlong[:, ::1] rows
    cdef public double reach
    @cython.locals(place=cython.uint)
    cpdef object add(self, cython.longlong t_ns, const cython.uchar[::1] data, bint is_late=*)
    cdef bint _put(self, cython.longlong t_ns, double by) except -1 nogil
    cdef int _grow(self, State *x) except -1 with gil
    cdef bint _is_full(self, cython.longlong i) noexcept nogil
cdef double difference(State *x, const cython.short[:, ::1] rows) noexcept nogil
cpdef tuple words(list rows, object other)
"""
PYTHONS_ALONE = {
    "mavlink.dejitter": {"_learn", "_update_statistics"},
    "mavlink.timebase": {"behind", "_learn"},
}
"""Methods with a generator, or whose arguments go by name only."""


def test_a_header_says_in_c_what_the_source_says():
    assert signatures("core.queue", SOURCE) == HEADER


def test_out_of_the_kernel_what_handles_an_object_may_raise():
    functions = {
        "def far(a: float) -> float: ...": "cpdef double far(double a)",
        "def _near(a: float) -> None: print(a)": "cdef object _near(double a)",
        "def _at(a: Column[np.int8]) -> float: return a[0]": (
            "cdef double _at(cython.schar[::1] a) noexcept"
        ),
        "def _is_at(a: float) -> bool: return a in PLACES": "cdef bint _is_at(double a)",
        "def _is_near(a: float) -> bool: return _is_at(a)": "cdef bint _is_near(double a)",
    }
    header = signatures("nav.near", "\n".join(functions))
    assert header.splitlines()[2:] == [*functions.values()]


@pytest.mark.parametrize("name", compiled_modules())
def test_the_header_of_a_module_is_that_of_its_source_and_has_all_its_functions(name):
    text = path_of(name).read_text(encoding="utf-8")
    header = path_of(name).with_suffix(".pxd").read_text(encoding="utf-8")
    assert header == signatures(name, text)
    body = ast.parse(text).body
    inside = [part for one in body if isinstance(one, ast.ClassDef) for part in one.body]
    functions = [one for one in (*body, *inside) if isinstance(one, ast.FunctionDef)]
    missing = {
        one.name
        for one in functions
        if not (one.decorator_list or one.name.startswith("__") or f" {one.name}(" in header)
    }
    assert missing == PYTHONS_ALONE.get(name, set())


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("def far(a: Stat) -> None: ...", "far, a: nobody knows Stat"),
        ("def far(a) -> None: ...", "far, a: has no annotation"),
        ("def far(a: int) -> list[int] | Any: ...", "far, returned: nobody knows Any"),
        ("class Far:\n def see(self, by: Eye) -> None: ...", "Far.see, by: nobody knows Eye"),
        ("class Far:\n near: Nearr", "Far.near: nobody knows Nearr"),
    ],
)
def test_an_annotation_that_says_nothing_is_named(source, message):
    with pytest.raises(TypeError, match=f"core.far: {message}"):
        signatures("core.far", f"\nfrom cython.cimports.libc.math import sqrt\n{source}")

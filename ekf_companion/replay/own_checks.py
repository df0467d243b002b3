"""Checks of what a user's own aid or filter returns, which say what is wrong with it."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.errors import DataError
from ekf_companion.filters.observation import Observation
from ekf_companion.filters.solution import Solution
from ekf_companion.filters.strapdown import N, Nominal
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.state import COLUMNS, QUATERNION, SIGMA, Table
from ekf_companion.replay.moments import Moment, stamp_ns

MOST_ROWS = 3
"""Numbers that an aid has at most: the gate knows their chi-square distributions."""
UNIT = 1e-3
"""How far from 1 the length of a quaternion may be: it was rounded, or not yet normalised."""
_METHODS = ("innovation", "covariance", "jacobian")


def checked_aids(
    given: Iterable[tuple[Moment, Observation]], span_ns: Stamps
) -> tuple[list[tuple[int, Observation]], tuple[str, ...]]:
    """Return aids with their times in ns, each checked as it is used, and notes on them.

    Args:
        given: Times and aids: floats are s, integers ns, or dates.
        span_ns: The first and the last time of the recording, ns.

    Raises:
        DataError: One is no aid, a time is none, or none is within the recording.
    """
    aids: list[tuple[int, Observation]] = []
    if not isinstance(given, Iterable):
        raise DataError(f"aids: is {_said(given)}; give a list of pairs (time, aid)")
    for row, pair in enumerate(given):
        if not isinstance(pair, Sequence) or isinstance(pair, str) or len(pair) != 2:
            raise DataError(f"aids: row {row} is {_said(pair)}; give pairs (time, aid)")
        t, aid = pair
        if isinstance(aid, type):
            raise DataError(f"aids: row {row}: {aid.__name__} is a class; give one of its objects")
        if lacking := [one for one in ("aid", *_METHODS) if not hasattr(aid, one)]:
            raise DataError(
                f"aids: row {row}: {_said(aid)} has no {lacking[0]}; give pairs (time, aid), and "
                "let the aid be an OwnAid"
            )
        t_ns = stamp_ns(f"aids: row {row}", t)
        aids.append((t_ns, _Checked(aid, t_ns)))
    inside = [span_ns[0] <= t_ns <= span_ns[-1] for t_ns, _ in aids]
    if all(inside):
        return aids, ()
    first = aids[inside.index(False)][0]
    what = (
        f"aids: {inside.count(False)} of {len(aids)} lie outside the time of the recording, "
        f"{span_ns[0] * 1e-9:.3f} to {span_ns[-1] * 1e-9:.3f} s; the first is at "
        f"{first * 1e-9:.3f} s"
    )
    if not any(inside):
        raise DataError(f"{what}; floats are s and integers ns, of the clock of the others")
    return [one for one, is_in in zip(aids, inside, strict=True) if is_in], (
        f"{what}; they were not used",
    )


class _Checked:
    """An aid whose answers are looked at before a filter uses them."""

    def __init__(self, aid: Observation, t_ns: int) -> None:
        self._aid, self._where = aid, f"{type(aid).__name__} at {t_ns * 1e-9:.3f} s"
        self._rows: tuple[int, str] | None = None  # of what it returned first, and its name

    @property
    def aid(self) -> str:
        return self._aid.aid

    def covariance(self) -> Array:
        R = self._numbers("covariance", self._aid.covariance())
        if R.ndim != 2 or R.shape[0] != R.shape[1] or not 1 <= len(R) <= MOST_ROWS:
            self._refuse("covariance", f"the shape {R.shape}, not (m, m) with 1 to 3 rows")
        if not np.allclose(R, R.T, rtol=1e-9, atol=0.0) or np.linalg.eigvalsh(R)[0] <= 0.0:
            self._refuse("covariance", "no covariance: it must be symmetric and positive definite")
        self._agree("covariance", len(R))
        return R

    def innovation(self, state: Nominal) -> Array:
        z = self._numbers("innovation", self._aid.innovation(state))
        leading = np.shape(state.pos_n)[:-1]
        if z.shape[:-1] != leading or z.ndim == 0 or not 1 <= z.shape[-1] <= MOST_ROWS:
            index = ": index the state from the end, as in state.pos_n[..., 2:3]"
            wanted = ", ".join([*map(str, leading), "m"])
            rows = f"with m from 1 to {MOST_ROWS}{index}"
            self._refuse("innovation", f"the shape {z.shape}, not ({wanted}) {rows}")
        self._agree("innovation", z.shape[-1])
        return z

    def jacobian(self, state: Nominal) -> Array:
        self.innovation(state)  # of which the usual one is made
        H = self._numbers("jacobian", self._aid.jacobian(state))
        if H.ndim != 2 or H.shape[1] != N or not 1 <= len(H) <= MOST_ROWS:
            self._refuse("jacobian", f"the shape {H.shape}, not (m, {N})")
        self._agree("jacobian", len(H))
        return H

    def _agree(self, method: str, m: int) -> None:
        """Refuse an answer of as many numbers as another one has not."""
        self._rows = self._rows or (m, method)
        if m != self._rows[0]:
            self._refuse(method, f"m = {m}, and {self._rows[1]}() m = {self._rows[0]}")

    def _numbers(self, method: str, given: Any) -> Array:
        try:
            found = np.ma.asarray(given)
            if found.dtype.kind not in "biufO":
                raise TypeError("no real numbers")
            values = np.ma.filled(found.astype(np.float64), np.nan)
        except (TypeError, ValueError):
            self._refuse(method, f"{_said(given)}, not numbers")
        if not np.isfinite(values).all():
            self._refuse(method, f"{values.ravel()[~np.isfinite(values.ravel())][0]}")
        return values

    def _refuse(self, method: str, what: str) -> Any:
        raise DataError(f"{self._where}: {method}() returned {what}")


def check_callable(name: str, run: Callable[..., Any]) -> None:
    """Refuse a filter that does not take recording, settings and option.

    Raises:
        DataError: The sentence says so.
    """
    try:
        taken = inspect.signature(run)
    except (TypeError, ValueError):
        return  # a compiled function may have none
    try:
        taken.bind(None, None, "")
    except TypeError:
        raise DataError(
            f"{name}{taken}: a filter is a function of recording, settings and option"
        ) from None


def check_solution(name: str, found: Any) -> None:
    """Refuse what no filter can mean.

    Raises:
        DataError: The sentence says what is wrong.
    """
    if not isinstance(found, Solution):
        raise DataError(f"{name}: returned {_said(found)}; a filter returns a Solution")
    table = found.table
    if not isinstance(table, Table):
        raise DataError(f"{name}: the table of its Solution is {_said(table)}, not a Table")
    shape = (len(table), len(COLUMNS) - 1)
    if np.shape(table.values) != shape:
        raise DataError(
            f"{name}: the values of its table have the shape {np.shape(table.values)}, and its "
            f"stamps want {shape}: a column of COLUMNS each but the time"
        )
    if not len(table):
        raise DataError(f"{name}: returned no estimate")
    if np.asarray(table.stamp_ns).dtype.kind not in "iu" or np.any(np.diff(table.stamp_ns) < 0):
        raise DataError(f"{name}: the stamps of its table must be ascending integers, ns")
    length = np.linalg.norm(table.columns(QUATERNION), axis=1)
    _refuse_rows(name, np.abs(length - 1.0) > UNIT, "hold a quaternion that is not of length 1")
    _refuse_rows(name, (table.columns(SIGMA) < 0.0).any(axis=1), "hold a sigma below 0")
    _refuse_rows(
        name, np.isinf(table.values).any(axis=1), "hold infinity; what is not known is NaN"
    )
    if np.shape(found.covariance) != (len(found.covariance_ns), 9, 9):
        raise DataError(
            f"{name}: its covariances have the shape {np.shape(found.covariance)}, not "
            f"({len(found.covariance_ns)}, 9, 9) for as many stamps"
        )


def _refuse_rows(name: str, is_bad: npt.ArrayLike, what: str) -> None:
    is_bad = np.asarray(is_bad)
    if is_bad.any():
        raise DataError(
            f"{name}: {np.count_nonzero(is_bad)} of {len(is_bad)} estimates {what}, the first is "
            f"row {np.argmax(is_bad)}"
        )


def _said(given: Any) -> str:
    return "None" if given is None else f"{type(given).__name__} {given!r:.60}"

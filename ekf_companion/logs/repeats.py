"""Blocks of rows that stand in a log twice: a part that was downloaded, or joined, once too often.

The bytes of a row that holds a stamp are its identity, as those of a frame are live
(:mod:`ekf_companion.mavlink.past_frames`): no sensor says the same at the same time twice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.lib.recfunctions import repack_fields

from ekf_companion.logs.stored_rows import Column, StoredRows
from ekf_companion.nav.arrays import Mask, Stamps
from ekf_companion.nav.stamps import BACK_NS

KEPT = 1 << 17
"""Rows that are remembered: five minutes at 400 Hz."""


class Repeats:
    """Finds rows that were there before, where the stamps of a table go back."""

    def __init__(self) -> None:
        """Begin with none."""
        self.count = 0
        """Rows found."""
        self._past = np.zeros(0, dtype=np.uint64)
        self._newest_ns: int | None = None
        self._is_within = False

    def take(self, t_ns: Stamps, rows: npt.NDArray[Any]) -> Mask:
        """Return which of the next rows repeat earlier ones.

        Args:
            t_ns: Their stamps, ns, shape (n,).
            rows: All their columns, n rows of numbers or of a record each.
        """
        found = np.zeros(len(t_ns), dtype=bool)
        if not len(t_ns):
            return found
        first_ns = int(t_ns[0]) - 1 if self._newest_ns is None else self._newest_ns
        newest = np.maximum.accumulate(np.append(first_ns, t_ns))
        known = np.append(self._past, _marks(rows))
        is_back = t_ns < newest[:-1] - BACK_NS
        if self._is_within or is_back.any():
            _, first, which = np.unique(known, return_index=True, return_inverse=True)
            is_copy = first[which] < np.arange(len(known))
            # 0 is no time, so it tells no row from another
            found = is_copy[len(self._past) :] & (t_ns <= newest[:-1]) & (t_ns != 0)
            # A block begins where copies go back, and ends where time goes on
            row = np.arange(1, len(t_ns) + 1)
            begin = np.maximum.accumulate(np.where(found & is_back, row, 0))
            end = np.maximum.accumulate(
                np.where(t_ns > newest[:-1], row, -1 if self._is_within else 0)
            )
            is_within = begin > end
            found &= is_within
            self._is_within = bool(is_within[-1])
        self._past, self._newest_ns = known[-KEPT:], int(newest[-1])
        self.count += int(found.sum())
        return found


def _marks(rows: npt.NDArray[Any]) -> npt.NDArray[np.uint64]:
    """Return a number for each row that another row has by a chance of 2 to the -64."""
    size = rows.dtype.itemsize * int(np.prod(rows.shape[1:], dtype=int))
    padded = np.zeros((len(rows), -(-size // 8) * 8), dtype=np.uint8)
    padded[:, :size] = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), size)
    words = padded.view(np.uint64)
    factors = np.random.default_rng(1).integers(0, 1 << 64, words.shape[1], dtype=np.uint64)
    words = (words ^ (words >> np.uint64(31))) * (factors | np.uint64(1))
    return np.asarray((words ^ (words >> np.uint64(29))).sum(axis=1, dtype=np.uint64))


def goes_back(parts: Iterable[Stamps]) -> bool:
    """Return whether stamps that come part by part go back further than a late one."""
    last_ns = None
    for t_ns in parts:
        if len(t_ns):
            if (np.diff(t_ns, prepend=t_ns[0] if last_ns is None else last_ns) < -BACK_NS).any():
                return True
            last_ns = t_ns[-1]
    return False


def left_out(
    tables: Mapping[str, StoredRows],
    stamps: Callable[[Column], Stamps | None],
    place: str = "",
) -> tuple[dict[str, StoredRows], list[str]]:
    """Return tables without the rows that repeat earlier ones, and a note on how many did.

    Args:
        tables: By name.
        stamps: Returns the stamps of rows of a table, ns; None: they have none.
        place: Column that says where in the file a row stood, which is not the row's.
    """
    kept, count = {**tables}, 0
    for name, table in tables.items():
        if stamps(table.read(0, 0)) is None or not goes_back(_stamps(table, stamps)):
            continue
        found, own = Repeats(), [one for one in table.names if one != place]
        masks = {
            first: ~found.take(t_ns, repack_fields(rows[own]))
            for first, t_ns, rows in _parts(table, stamps)
        }
        kept[name] = table.kept(partial(_mask, masks))
        count += found.count
    return kept, note(count)


def _mask(masks: Mapping[int, Mask], first: int, _: Column) -> Mask:
    return masks[first]


def _parts(
    table: StoredRows, stamps: Callable[[Column], Stamps | None]
) -> Iterator[tuple[int, Stamps, Column]]:
    for first, rows in table.parts():
        t_ns = stamps(rows)
        assert t_ns is not None, "only stamped rows are looked at"
        yield first, t_ns, rows


def _stamps(table: StoredRows, stamps: Callable[[Column], Stamps | None]) -> Iterator[Stamps]:
    return (t_ns for _, t_ns, _ in _parts(table, stamps))


def note(count: int) -> list[str]:
    """Return a note on rows that stand in a log twice; none if none does."""
    if count == 1:
        return ["1 row repeats an earlier one to the bit, and counts once"]
    return [f"{count} rows repeat earlier ones to the bit, and count once"] if count else []

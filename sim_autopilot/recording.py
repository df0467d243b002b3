"""Files: the truth as CSV, frames as a .tlog."""

from __future__ import annotations

import json
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from ekf_companion.logs.writer import create
from ekf_companion.nav import so3
from sim_autopilot.flight import Flight

TRUTH_HEADER = (
    "time_us,lat_deg,lon_deg,alt_m,n_m,e_m,d_m,vn_mps,ve_mps,vd_mps,"
    "q_w,q_x,q_y,q_z,roll_rad,pitch_rad,yaw_rad,p_radps,q_radps,r_radps"
)
_ROW = ",".join(
    ["%d", "%.9f", "%.9f", "%.4f"] + ["%.4f"] * 3 + ["%.5f"] * 3 + ["%.9f"] * 4 + ["%.8f"] * 6
)
_CHUNK = 4096


def write_truth(path: Path, flight: Flight) -> None:
    """Write the motion at every inertial sample."""
    with create(path) as file:
        file.write(f"{TRUTH_HEADER}\n".encode())
        for start in range(0, len(flight), _CHUNK):
            t = flight.imu.t[start : start + _CHUNK]
            truth = flight.trajectory.at(t)
            table = np.column_stack(
                [
                    [flight.to_ns(now) // 1000 for now in t.tolist()],
                    np.degrees(truth.lat),
                    np.degrees(truth.lon),
                    truth.alt,
                    truth.pos_n,
                    truth.vel_n,
                    truth.q_nb,
                    so3.wrap(truth.euler),
                    truth.rate_nb_b,
                ]
            )
            file.writelines(f"{_ROW % tuple(row)}\n".encode() for row in table.tolist())


def write_score(path: Path, score: dict[str, Any]) -> None:
    """Write a score as JSON."""
    with create(path) as file:
        file.write(f"{json.dumps(score, indent=2)}\n".encode())


class TlogWriter(AbstractContextManager["TlogWriter"]):
    """A telemetry log: before each frame its time, in microseconds since 1970."""

    def __init__(self, path: Path, unix: float) -> None:
        self._stack = ExitStack()
        self._file = self._stack.enter_context(create(path))
        self._unix_us = round(unix * 1e6)

    def write(self, now_ns: int, frame: bytes) -> None:
        """Append a frame with a time on the autopilot's clock."""
        # The low two bits are the number of the link
        stamp = (self._unix_us + now_ns // 1000) & ~3
        self._file.write(stamp.to_bytes(8, "big") + frame)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Give the file its name; after an error drop it. A flight stopped by Ctrl-C is whole."""
        if kind is KeyboardInterrupt:
            kind = error = trace = None
        self._stack.__exit__(kind, error, trace)

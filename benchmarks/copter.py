"""Why our numbers on ArduPilot's logs are what they are: board trim, GNSS as a judge, a crash."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pymavlink.DFReader import DFReader_binary

from benchmarks.cases import COPTER, NETHERLANDS, NO_GNSS, estimate
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Table, Trajectory
from ekf_companion.replay import log_source

Array = npt.NDArray[np.float64]

BURST = 100.0
"""m/s^2; the ground."""
FLIGHT = (61.0, 205.0)
"""s after the first estimate: in the air, and before the crash."""
CIRCLE = (131.0, 138.0)
"""s; where the two estimates are furthest apart."""
LAGS = np.arange(0.0, 0.5, 0.02)
"""s; by which the receiver's velocity is taken to be late."""


def trims(data: Path) -> Iterator[str]:
    """Give AHRS_TRIM beside the mean difference of roll and pitch."""
    yield "| log | AHRS_TRIM_X, deg | mean roll, ours less its own | AHRS_TRIM_Y | mean pitch |"
    yield "|---|---|---|---|---|"
    for log, until in ((COPTER, 205.0), (NETHERLANDS, None), (NO_GNSS, None)):
        path = data / log
        if path.is_file():
            roll, pitch = _mean_tilt(path, until)
            x, y = (_parameter(path, f"AHRS_TRIM_{axis}") for axis in "XY")
            yield f"| {path.parent.name} | {x:+.2f} | {roll:+.2f} | {y:+.2f} | {pitch:+.2f} |"


def _mean_tilt(path: Path, until: float | None) -> Array:
    """Give the mean of our roll and pitch less the autopilot's, after 20 s, deg."""
    table, _, reference, _ = estimate(path)
    assert reference is not None, "the log holds its own estimate"
    t_ns = reference.att_t_ns
    first = int(table.stamp_ns[np.isfinite(table.column("roll"))][0])
    chosen = (t_ns > first + 20e9) & (t_ns < table.stamp_ns[-1])
    if until is not None:
        chosen &= t_ns < first + until * 1e9
    ours = np.column_stack([table.column(name) for name in ("roll", "pitch")])
    offset = _at(t_ns[chosen], table.stamp_ns, ours) - so3.to_euler(reference.q_nb)[chosen, :2]
    return np.asarray(np.degrees(np.mean(offset, axis=0)))


def _parameter(path: Path, name: str) -> float:
    """Give a parameter, an angle, in degrees; NaN where the log does not say."""
    log = DFReader_binary(str(path))
    value = np.nan
    while (message := log.recv_match(type="PARM")) is not None:
        if message.Name == name:
            value = float(np.degrees(message.Value))
    return value


def judge(data: Path) -> Iterator[str]:
    """Give how far EKF1 and we are from the receiver's velocity, each at its best lag."""
    path = data / COPTER
    if not path.is_file():
        return
    fixes, table, reference = _copter(path)
    ours = np.column_stack([table.column(name) for name in ("vel_n", "vel_e", "vel_d")])
    t = (fixes.t_ns - table.stamp_ns[0]) * 1e-9
    flight, circle = (fixes.take((t > part[0]) & (t < part[1])) for part in (FLIGHT, CIRCLE))
    yield "| velocity against the receiver's | best lag, s | RMS, m/s | in the circle, m/s |"
    yield "|---|---|---|---|"
    for name, stamps, vel_n in (
        ("EKF1", reference.vel_t_ns, reference.vel_n),
        ("ours", table.stamp_ns, ours),
    ):
        lags = [(_apart(flight, lag, stamps, vel_n), lag) for lag in LAGS]
        rms, lag = min(lags)
        turning = min(_apart(circle, lag, stamps, vel_n) for lag in LAGS)
        yield f"| {name} | {lag:.2f} | {rms:.2f} | {turning:.2f} |"
    early = (reference.vel_t_ns - table.stamp_ns[0]) * 1e-9 < FLIGHT[0]
    drift = np.linalg.norm(reference.vel_n[early], axis=1).max()
    at_rest = np.linalg.norm(fixes.values[t < FLIGHT[0] - 1.0, 3:5], axis=1).max()
    yield ""
    yield (
        f"Before take-off EKF1 says up to {drift:.1f} m/s, the receiver at most {at_rest:.1f} m/s."
    )


def _apart(fixes: Events, lag: float, stamps: npt.NDArray[np.int64], vel_n: Array) -> float:
    """Give the RMS difference of a velocity from the receiver's, taken to be late, m/s."""
    return _rms(_at(fixes.t_ns - round(lag * 1e9), stamps, vel_n) - fixes.values[:, 3:6])


def crash(data: Path) -> Iterator[str]:
    """Give the speeds about the moment when the copter hits the ground."""
    path = data / COPTER
    if not path.is_file():
        return
    fixes, table, reference = _copter(path)
    samples = _events(path, Kind.IMU)
    first = int(samples.t_ns[0])
    force = np.linalg.norm(samples.values[:, 3:6], axis=1)
    hit = samples.t_ns[np.argmax(force > BURST)]
    seconds = (hit - first) * 1e-9
    yield f"The hardest blow: {force.max():.0f} m/s2, {seconds:.1f} s after the first sample."
    yield ""
    yield "| after it, s | GNSS, m/s | EKF1, m/s | ours, m/s | EKF1 off by | ours off by |"
    yield "|---|---|---|---|---|---|"
    ours = np.column_stack([table.column(name) for name in ("vel_n", "vel_e", "vel_d")])
    for after in (-5.0, -1.0, 0.5, 1.0, 2.0, 3.0, 5.0, 8.0, 12.0):
        at = np.array([hit + round(after * 1e9)])
        gnss = _at(at, fixes.t_ns, fixes.values[:, 3:6])[0]
        theirs = _at(at, reference.vel_t_ns, reference.vel_n)[0]
        own = _at(at, table.stamp_ns, ours)[0]
        sizes = [gnss, theirs, own, theirs - gnss, own - gnss]
        cells = " | ".join(f"{np.linalg.norm(size):.1f}" for size in sizes)
        yield f"| {after:+.1f} | {cells} |"


def _copter(path: Path) -> tuple[Events, Table, Trajectory]:
    """Give the fixes, our estimates and the autopilot's."""
    table, _, reference, _ = estimate(path)
    assert reference is not None, "the log holds its own estimate"
    return _events(path, Kind.GNSS), table, reference


def _events(path: Path, kind: Kind) -> Events:
    events: Events = log_source.READERS[path.suffix](path).events
    return events.take(events.kind == kind)


def _at(t_ns: npt.NDArray[np.int64], stamps: npt.NDArray[np.int64], values: Array) -> Array:
    """Interpolate columns at stamps, shape (n, columns)."""
    at, known = (t_ns - stamps[0]) * 1e-9, (stamps - stamps[0]) * 1e-9
    return np.column_stack([np.interp(at, known, column) for column in values.T])


def _rms(offset: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(offset**2, axis=1))))

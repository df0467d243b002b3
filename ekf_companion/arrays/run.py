"""Arrays of measurements in, a trajectory out: for those who have neither a log nor a link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.arrays.estimates import Estimates
from ekf_companion.arrays.reader import UNITS, Reader
from ekf_companion.arrays.types import (
    Columns,
    Fixes,
    Headings,
    Heights,
    MagneticField,
    Units,
)
from ekf_companion.core.memory.aid import find
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.faults import NO_EVIDENCE, FoundFault
from ekf_companion.errors import ConfigError, DataError, LogError
from ekf_companion.filters.observation import Observation
from ekf_companion.logs.recording import Recording
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Stamps, known_rows
from ekf_companion.nav.earth import PRESSURES, pressure_altitude
from ekf_companion.nav.measurements import (
    GNSS_VELOCITY,
    Events,
    GnssFlag,
    HeadingSource,
    Kind,
    merge,
)
from ekf_companion.nav.state import join
from ekf_companion.replay.filters_by_name import (
    EskfSolution,
    FilterName,
    Run,
    counts_of,
    late_fixes,
    run_filter,
)
from ekf_companion.replay.moments import Moment
from ekf_companion.replay.smoothing import Smoothing
from ekf_companion.review import account, plausibility
from ekf_companion.review.agreement import contradictions
from ekf_companion.review.clocks import clock_disagreement
from ekf_companion.review.fixes import suspicion

NAVIGATING = ("eskf", "euler", "iterated", "ukf")
"""Filters that estimate a position from fixes."""
_GNSS = ("lat_deg", "lon_deg", "lat_rad", "lon_rad", "alt", "vel_n", "std_h", "std_v", "std_vel")
STD_H, STD_V, STD_VEL = 1.5, 2.5, 0.3
"""One sigma of fixes whose accuracy is not given, m, m and m/s."""


def estimate(
    time: npt.ArrayLike,
    gyro: npt.ArrayLike,
    accel: npt.ArrayLike,
    *,
    gnss: Fixes | Columns | None = None,
    heading: Headings | Columns | None = None,
    mag: MagneticField | Columns | None = None,
    baro: Heights | Columns | None = None,
    filter: FilterName | Run = "eskf",
    smooth: bool = False,
    settings: FilterSettings | None = None,
    aids: Sequence[tuple[Moment, Observation]] | Mapping[str, Columns] = (),
    units: Units | None = None,
    check: bool = True,
) -> Estimates:
    """Estimate a trajectory from arrays of measurements.

    Axes are the vehicle's: forward, right, down. All times are of one clock: floats in s, integers
    in ns, or in the unit that ``units`` names; or ``datetime64`` or ``datetime``, of any zone.

    Args:
        time: Of the inertial samples, shape (n,).
        gyro: Angular rates, rad/s, shape (n, 3).
        accel: Specific force, m/s^2, shape (n, 3): about (0, 0, -9.81) at rest and level.
        gnss: Fixes: ``time``, ``lat_deg`` and ``lon_deg`` (or ``lat_rad``, ``lon_rad``), ``alt`` (m
            above mean sea level), each of shape (m,); optionally ``vel_n`` (north, east, down, m/s,
            shape (m, 3)) and one sigma ``std_h``, ``std_v`` (m), ``std_vel`` (m/s), each a number
            or of shape (m,).
        heading: ``time`` and ``heading`` (rad from true north, clockwise), each of shape (m,);
            optionally ``std`` (rad; 0.05).
        mag: ``time``, shape (m,), and ``field`` (gauss, shape (m, 3)).
        baro: ``time`` and ``alt`` (m) or ``pressure`` (Pa), each of shape (m,).
        filter: ``eskf``, ``euler``, ``iterated``, ``ukf``, ``ahrs``, ``mahony``, ``vqf``,
            ``zupt``, with an option as in ``iterated:robocentric``; or a function of your own.
        smooth: Whether each estimate also uses what came later (``eskf`` only).
        settings: Noise, gates, lever arm and so on; None: the defaults.
        aids: Of other sensors by name, as ``{"baro": {"time": ..., "alt": ...}}``: the columns are
            those that the aid declares, :data:`~ekf_companion.core.memory.aid.DECLARED`. Or
            measurements of your own, with their times (floats in s, integers in ns, or dates): see
            :class:`~ekf_companion.filters.own_aid.OwnAid`.
        units: Units of ``time``, ``gyro``, ``accel`` and ``mag`` that are not the ones above, of
            :data:`~.reader.UNITS`: ``{"gyro": "deg/s", "accel": "g", "time": "us"}``.
        check: Whether to refuse what cannot be meant: other units, axes or signs, north and east
            exchanged, radians for degrees.

    Returns:
        An estimate per inertial sample; ``notes`` say what is doubtful, and what was not used.

    Raises:
        DataError: The arrays cannot be meant; the sentence says why, and what would do.
        ConfigError: There is no such filter, unit or column.
        LogError: Nothing can be estimated from them.
    """
    chosen = settings or FilterSettings()
    if not isinstance(chosen, FilterSettings):
        raise ConfigError(
            f"settings: must be a FilterSettings, not {type(chosen).__name__}, as in "
            "FilterSettings(gnss=GnssSettings(delay=0.2))"
        )
    read = Reader(units, check, chosen.gnss.delay)
    faults: tuple[FoundFault, ...] = ()
    evidence = NO_EVIDENCE
    others = aids if isinstance(aids, Mapping) else {}
    own = () if isinstance(aids, Mapping) else aids
    events = _read(read, time, gyro, accel, others, gnss=gnss, heading=heading, mag=mag, baro=baro)
    recording = Recording(family="unknown", events=events)
    if smooth:
        if filter != "eskf" or own:
            raise ConfigError("smooth: smooths eskf without aids of your own; leave it or them out")
        with Smoothing(chosen) as smoothing:
            smoothing.run(events)
            table, counts = join(list(smoothing.tables())), counts_of(smoothing.health())
            notes = late_fixes(smoothing, chosen, recording)
            faults, evidence = tuple(smoothing.found_faults()), smoothing.fault_evidence()
        notes += tuple(account.late_begin(table, events))
    else:
        solution = run_filter(recording, filter, chosen, aids=own)
        table, counts, notes = solution.table, dict(solution.counts), solution.notes
        if isinstance(solution, EskfSolution):
            faults, evidence = solution.faults, solution.evidence
    if not np.isfinite(table.column("q_w")).any():
        span = (events.t_ns[-1] - events.t_ns[0]) * 1e-9
        why = "; ".join(["", *read.notes])
        raise LogError(
            f"nothing could be estimated: down was not found in {span:.1f} s with "
            f"{np.count_nonzero(events.kind == Kind.IMU)} inertial samples; give more of the "
            f"recording, best with a second at rest at its begin{_without_velocity(events)}{why}"
        )
    has_position = not isinstance(filter, str) or filter.partition(":")[0] in NAVIGATING
    if gnss is not None and not has_position:
        read.notes.append(
            f"{filter}: takes no fixes, so positions and velocities of gnss were not used; "
            f"{', '.join(NAVIGATING)} do"
        )
    if len(table) != (rows := len(np.atleast_1d(time))):
        read.notes.append(
            f"the trajectory has {len(table)} rows for {rows} times: take them together by "
            "track.time, not by row"
        )
    said = account.sentences(table, events, counts, has_position=has_position)
    found = [f"fault: {one.words(int(events.t_ns[0]))}" for one in faults]
    notes = (*read.notes, *said, *notes, *found)
    return Estimates(table, notes, dropped=read.dropped, faults=faults, evidence=evidence)


def _without_velocity(events: Events) -> str:
    """Return what fixes without a velocity lack; empty: nothing."""
    fixes = events.values[events.kind == Kind.GNSS]
    if not len(fixes) or np.isfinite(fixes[:, GNSS_VELOCITY]).any():
        return ""
    return (
        "; gnss has no vel_n: with the velocity of the fixes down is found in motion too, and "
        "without it only at rest or in steady flight"
    )


def to_events(
    time: npt.ArrayLike,
    gyro: npt.ArrayLike,
    accel: npt.ArrayLike,
    *,
    gnss: Fixes | Columns | None = None,
    heading: Headings | Columns | None = None,
    mag: MagneticField | Columns | None = None,
    baro: Heights | Columns | None = None,
    aids: Mapping[str, Columns] | None = None,
    units: Units | None = None,
    check: bool = True,
) -> Events:
    """Return arrays as the events of a recording; arguments and errors as for :func:`estimate`."""
    read = Reader(units, check)
    return _read(
        read, time, gyro, accel, aids or {}, gnss=gnss, heading=heading, mag=mag, baro=baro
    )


def _read(
    read: Reader,
    time: npt.ArrayLike,
    gyro: npt.ArrayLike,
    accel: npt.ArrayLike,
    aids: Mapping[str, Columns],
    **sensors: Mapping[str, Any] | None,
) -> Events:
    """Return arrays as events; ``read`` holds the notes on them."""
    t_ns = read.times("time", time, is_inertial=True)
    turn = read.array("gyro", gyro, (len(t_ns), 3))
    force = read.array("accel", accel, (len(t_ns), 3))
    if read.check:
        plausibility.check_inertial(turn, force, t_ns)
    read.note_rough("gyro", turn)
    read.note_rough("accel", force)
    tables = {
        name: convert(read, given, t_ns)
        for name, convert in _TABLES.items()
        if (given := sensors[name]) is not None
    }
    for name, given in aids.items():
        if name in tables:
            raise ConfigError(f"aids: {name}: is given twice")
        tables[name] = _aid(read, name, given, t_ns)
    imu = Events.from_columns(t_ns, Kind.IMU, *turn.T, *force.T)
    fixes, baro, mag = (tables.get(name) for name in ("gnss", "baro", "mag"))
    found = contradictions(imu, fixes, baro, mag) if read.check else []
    if read.check and fixes is not None and not found:
        found = [said] if (said := clock_disagreement(imu, fixes, read.delay)) else []
    if found:
        raise DataError(f"{'; '.join(found)}. If it is meant so: check=False")
    if fixes is not None and (doubt := suspicion(fixes)):
        read.notes.append(doubt)
    return merge(*tables.values(), imu)


def _gnss(read: Reader, given: Mapping[str, Any], imu_ns: Stamps) -> Events:
    t_ns = read.columns("gnss", given, _GNSS, imu_ns)
    unit = "deg" if "lat_deg" in given else "rad"
    for needed in (f"lat_{unit}", f"lon_{unit}", "alt"):
        if needed not in given:
            raise DataError(f"gnss: needs {needed}; it has time, lat_{unit}, lon_{unit} and alt")
    count = (len(t_ns),)
    lat, lon, alt = (
        read.array(f"gnss.{name}", given[name], count) * size
        for name, size in (
            (f"lat_{unit}", np.deg2rad(1.0) if unit == "deg" else 1.0),
            (f"lon_{unit}", np.deg2rad(1.0) if unit == "deg" else 1.0),
            ("alt", 1.0),
        )
    )
    vel_n = np.full((len(t_ns), 3), np.nan)
    if "vel_n" in given:
        vel_n = read.array("gnss.vel_n", given["vel_n"], (len(t_ns), 3)).copy()
        unknown = ~known_rows(vel_n[:, :2])
        vel_n[unknown] = np.nan
        then = "their positions count without a velocity"
        read.drop("gnss.vel_n", unknown, "hold NaN or infinity north or east", then)
    if read.check:
        plausibility.check_place(lat, lon, unit)
        plausibility.check_velocity(t_ns, alt, vel_n)
    stds = [
        read.std(f"gnss.{name}", given.get(name, default), count)
        for name, default in (("std_h", STD_H), ("std_v", STD_V), ("std_vel", STD_VEL))
    ]
    flags = np.full(count, float(GnssFlag.NONE))
    nothing = np.full(count, np.nan)
    return Events.from_columns(
        t_ns, Kind.GNSS, lat, so3.wrap(lon), alt, *vel_n.T, *stds, nothing, flags
    )


def _heading(read: Reader, given: Mapping[str, Any], imu_ns: Stamps) -> Events:
    t_ns = read.columns("heading", given, ("heading", "std"), imu_ns)
    angle = read.array("heading.heading", given["heading"], (len(t_ns),))
    if read.check and np.nanmax(np.abs(angle)) > 2.0 * np.pi + 1e-6:
        raise DataError("heading: reaches beyond 2 pi; it must be rad: give np.deg2rad(heading)")
    std = read.std("heading.std", given.get("std", 0.05), (len(t_ns),))
    source = np.full(len(t_ns), float(HeadingSource.GNSS))
    return Events.from_columns(t_ns, Kind.HEADING, so3.wrap(angle), std, source)


def _mag(read: Reader, given: Mapping[str, Any], imu_ns: Stamps) -> Events:
    t_ns = read.columns("mag", given, ("field",), imu_ns)
    field = read.array("mag.field", given["field"], (len(t_ns), 3))
    size = float(np.nanmedian(np.linalg.norm(field, axis=1)))
    if read.check and not 0.1 < size < 1.5:
        raise DataError(
            f"mag: its median strength is {size:.3g} gauss, and the Earth's field has 0.22 to "
            f"0.67; name its unit, units={{'mag': ...}}, of {', '.join(UNITS['mag'])}"
        )
    return Events.from_columns(t_ns, Kind.MAG, *field.T)


def _baro(read: Reader, given: Mapping[str, Any], imu_ns: Stamps) -> Events:
    t_ns = read.columns("baro", given, ("alt", "pressure"), imu_ns)
    if "pressure" in given:
        pressure = read.array("baro.pressure", given["pressure"], (len(t_ns),))
        if read.check and not PRESSURES[0] < float(np.nanmedian(pressure)) < PRESSURES[1]:
            raise DataError(
                f"baro: pressure: its median is {np.nanmedian(pressure):.5g} Pa, which no air has; "
                "1013 hPa are 101300 Pa"
            )
        alt = np.array([pressure_altitude(one) for one in pressure.tolist()])
    else:
        alt = read.array("baro.alt", given["alt"], (len(t_ns),))
    return Events.from_columns(t_ns, Kind.BARO, alt)


def _aid(read: Reader, name: str, given: Mapping[str, Any], imu_ns: Stamps) -> Events:
    """Return the measurements of an aid that declares itself."""
    aid = find(name)
    t_ns = read.columns(name, given, (*aid.row,), imu_ns)
    columns = []
    for column, value in aid.row.items():
        if column not in given and not value.is_optional:
            raise DataError(f"{name}: needs {column} ({value.unit})")
        if column not in given:
            columns.append(np.full(len(t_ns), np.nan))
            continue
        values = read.array(f"{name}.{column}", given[column], (len(t_ns),))
        is_possible = (value.low < values) & (values < value.high)
        is_possible |= np.isnan(values) & value.is_optional
        limits = f"{value.low:g} to {value.high:g} {value.unit}"
        read.drop(f"{name}.{column}", ~is_possible, f"lie outside of what there is, {limits}")
        columns.append(values)
    return Events.from_columns(t_ns, aid.kind, *columns)


_TABLES = {"gnss": _gnss, "heading": _heading, "mag": _mag, "baro": _baro}

"""Reading of ArduPilot's DataFlash logs (.bin) into a recording.

GPYW (raw moving-baseline yaw) is not used: its angle is that of the baseline, and the row does not
hold how the antennas are mounted. GPS.Yaw is the vehicle's.

Source: ArduPilot libraries/AP_Logger/LogStructure.h and the LogStructure.h of AP_GPS,
AP_InertialSensor, AP_Compass, AP_Baro, AP_AHRS, AP_NavEKF3 and SITL (fields, units).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.logs import aids, receiver_time, series
from ekf_companion.logs.dataflash_columns import boot_ns, names_of, parameter
from ekf_companion.logs.dataflash_records import OFFSET, Tables, read_tables
from ekf_companion.logs.dataflash_sensors import INSTANCE
from ekf_companion.logs.dataflash_tables import (
    NEEDED,
    READ,
    Columns,
    choose,
    rows_of,
)
from ekf_companion.logs.dataflash_text import text_of
from ekf_companion.logs.dataflash_trajectory import reference, truth
from ekf_companion.logs.inertial_units import STDS
from ekf_companion.logs.recording import CUT, Recording, cut_short
from ekf_companion.logs.series import FIX_3D, GNSS_HEADING_STD, HEADING_RATE, HEADING_STD
from ekf_companion.logs.stored_rows import Column, StoredRows
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Mask, Stamps
from ekf_companion.nav.earth import is_place
from ekf_companion.nav.event_columns import (
    Arrivals,
    EventColumns,
    EventSource,
    MergedEvents,
    sources_of,
)
from ekf_companion.nav.measurements import GnssFlag, HeadingSource, Kind, VehicleType
from ekf_companion.nav.mounting import trim_matrix

DEFINITIONS = {"FMT", "FMTU", "UNIT", "MULT", "PARM"}
"""Messages that describe others, or the autopilot's setup, rather than measurements."""
STREAMED = ("IMU", "MAG", "BARO")
"""Messages whose rows are never in memory all at once."""

GNSS_STD_MIN = 0.5
"""m; ArduPilot's own default for a receiver that gives no accuracy (EK3_POSNE_M_NSE)."""
GNSS_STD_PER_DOP = 1.0
"""m of horizontal error per HDop: the range error of a receiver in the open, 1 m."""
GNSS_STD_RATIO = 1.5
"""Vertical by horizontal error of such a receiver."""
GNSS_STD_VEL = 0.3
"""m/s; ArduPilot's default for a receiver that gives no accuracy (EK3_VELNE_M_NSE)."""
SAMPLE_TIME_NS = 1_000_000_000
"""GPA.SMS further than this from the row's own stamp is damaged or of another clock."""
GPS_EPOCH_S, LEAP_S = 315_964_800, 18
"""1980-01-06, s since 1970; GPS time less UTC since 2017."""
FIRST_TIME_US = "2014-06"
"""Date at which ArduPilot began to write stamps in microseconds (3.3)."""
FIRST_DATES = ("2019", "2019", "2021", "2022", "2022", "2023", "2023", "2024")
"""Year in which the development of ArduPilot 4.0, 4.1, ... began."""
_FIRMWARES = {
    b"ArduPlane": VehicleType.FIXED_WING,
    b"ArduCopter": VehicleType.ROTARY,
    b"ArduRover": VehicleType.GROUND,
}
"""A rover may be a boat, to which wheels are no sensor."""
_VERSION = re.compile(rb"(?:Ardu|Blimp|Antenna)\w* V4\.(\d{1,2})\b")
"""How the firmware names itself."""
_EVENTS = {
    10: ("armed", True),
    11: ("armed", False),
    18: ("landed", True),
    28: ("landed", False),
}
"""Meaning of EV.Id (AP_Logger.h, LogEvent)."""


@np.errstate(invalid="ignore", over="ignore")  # damaged bytes make any number
def read(path: Path) -> Recording:
    """Read a log into events, the autopilot's own estimate and, from a simulator, the truth.

    A log may lack IMU or GNSS rows; its events then lack them too.

    Raises:
        LogError: The file is not a DataFlash log, or holds none of the messages that are used.
    """
    found, notes, others, damage = read_tables(path, READ)
    said = {name for name, table in found.items() if len(table)} | others
    is_cut = not said - (DEFINITIONS if CUT in damage.words else {"FMT"})
    stored, extent_ns, misfit = choose(found, notes)
    tables = {name: table.all() for name, table in stored.items() if name not in STREAMED}
    turn = _to_vehicle(tables, notes)

    def streamed(name: str, take: Callable[[Columns], Arrivals]) -> Sequence[EventSource]:
        """Return the source of a message's events, which arrive at their places in the file."""
        if (table := stored.get(name)) is None:
            return ()

        @np.errstate(invalid="ignore", over="ignore")
        def read(first: int, end: int) -> Arrivals:
            return turn(take({name: table.read(first, end)}))

        return (EventSource(len(table), read),)

    receivers = _by_receiver(tables)
    gnss = [one for flag, rows in receivers for one in _gnss(rows, flag)]
    sources = sources_of([*gnss, *_vehicle(tables, stored)])
    sources += streamed("IMU", lambda rows: _sensor(rows, "IMU", Kind.IMU))
    headings = [one for _, rows in receivers for one in _gnss_heading(rows)]
    sources += sources_of([*headings, *_attitude_heading(tables)])
    sources += streamed("MAG", _Magnetometer(stored.get("MAG")))
    if _is_submarine(tables):
        notes.append(
            "this is a submarine: its first barometer measures the air within the hull, which is "
            "no height, and is not used"
        )
    else:
        sources += streamed("BARO", lambda rows: _sensor(rows, "BARO", Kind.BARO))
    for kind, aid in aids.DATAFLASH:
        sources += sources_of(_aid(tables, kind, aid))
    events = MergedEvents(sources)
    if not len(events) and is_cut:
        raise cut_short(path, path.stat().st_size)
    if not len(events):
        raise LogError(
            f"{path}: a DataFlash log without IMU, GPS, MAG, BARO or ATT rows; "
            "record with LOG_BITMASK bits IMU, GPS and ATTITUDE set"
        )
    fixes = max((events for events, _ in gnss), key=len, default=None)
    refused = len(tables.get("GPS", ())) - sum(len(events) for events, _ in gnss)
    if refused:
        notes.append(f"{refused} GPS rows without a 3-D fix were left out")
    unstamped = tables.get("MSG")
    message_ns = np.zeros(0, np.int64) if unstamped is None else _stamps_by_place(stored, unstamped)
    zero_ns = _utc_zero_ns(tables, notes)
    return Recording(
        family="ardupilot",
        events=events,
        reference=reference(tables, fixes, notes),
        truth=truth(tables),
        gnss_delay=_gnss_delay(tables),
        notes=tuple(notes),
        damage=damage.beside(misfit),
        lost_share=misfit.share,
        extent_ns=extent_ns,
        onboard=text_of(tables, message_ns),
        began_s=_began_s(stored, zero_ns),
        utc_zero_ns=zero_ns,
    )


def _began_s(stored: Tables, zero_ns: int | None) -> float | None:
    """Return the time at which the log began, s since 1970, UTC."""
    if zero_ns is None:
        return None
    stamped = [boot_ns(one.read(0, 1)) for one in stored.values() if "TimeUS" in one.names]
    firsts = [int(t_ns[0]) for t_ns in stamped if t_ns is not None]
    return zero_ns * 1e-9 + min(firsts) // 1000 * 1e-6


def _utc_zero_ns(tables: Columns, notes: list[str]) -> int | None:
    """Return the UTC at which the clock was zero, by the receiver's week and time of GPS."""
    names = ("TimeUS", "GWk", "GMS")
    if (table := tables.get("GPS")) is None or not {*names} <= {*(table.dtype.names or ())}:
        return None
    week, ms = (np.asarray(table[name], dtype=np.int64) for name in ("GWk", "GMS"))
    utc_ns = ((GPS_EPOCH_S + week * 604_800 - LEAP_S) * 1000 + ms) * 1_000_000
    is_fix = np.asarray((table["Status"] >= FIX_3D) & (week > 0))
    t_ns = series.nanoseconds(table["TimeUS"])
    return receiver_time.utc_zero_ns(utc_ns, t_ns, is_fix, _first_date(tables), notes)


def _first_date(tables: Columns) -> str:
    """Return the earliest date at which a log of its firmware can have been written."""
    table = tables.get("MSG")
    if table is not None and "Message" in names_of(table):
        for words in table["Message"]:
            if found := _VERSION.match(bytes(words)):
                return FIRST_DATES[min(int(found[1]), len(FIRST_DATES) - 1)]
    return FIRST_TIME_US


def _sensor(tables: Columns, name: str, kind: Kind) -> Arrivals:
    """Return the events of a message whose needed columns are those of the events, in SI."""
    if (rows := rows_of(tables, name)) is None:
        return []
    table, t_ns = rows
    more = STDS if kind is Kind.IMU and STDS[0] in names_of(table) else ()
    columns = [table[column] for column in (*NEEDED[name], *more)]
    return [(EventColumns(t_ns, kind, *columns), table[OFFSET])]


def _aid(tables: Columns, kind: Kind, aid: aids.Columns) -> Arrivals:
    """Return the events of an aid that declares itself."""
    if (rows := rows_of(tables, aid.name)) is None:
        return []
    table, t_ns = rows
    valid, columns = aid.read({one: table[one] for one in names_of(table)})
    chosen = [column[valid] for column in columns]
    return [(EventColumns(t_ns[valid], kind, *chosen), table[OFFSET][valid])]


def _accuracies(tables: Columns, t_ns: Stamps) -> tuple[Column, Mask] | None:
    """Return the GPA row nearest to each GPS row, and whether it was written with it."""
    if (rows := rows_of(tables, "GPA")) is None:
        return None
    table, at_ns = rows
    order = np.argsort(at_ns, kind="stable")
    index = order[series.nearest(t_ns, at_ns[order])]
    return table[index], np.abs(at_ns[index] - t_ns) < 50_000_000  # 50 ms: a quarter of 5 Hz


def _by_receiver(tables: Columns) -> list[tuple[GnssFlag, Columns]]:
    """Return the rows of each receiver in use, with the flag of the second receiver."""
    table = tables.get("GPS")
    if table is None or INSTANCE not in names_of(table):
        return [(GnssFlag.NONE, tables)]
    _, first = np.unique(table[INSTANCE], return_index=True)
    used = table[INSTANCE][np.sort(first)].tolist()
    accuracies = tables.get("GPA")
    found = []
    for place, number in enumerate(used):
        rows = {"GPS": table if len(used) == 1 else table[table[INSTANCE] == number]}
        if accuracies is not None:
            is_numbered = INSTANCE in names_of(accuracies)
            own = accuracies[accuracies[INSTANCE] == number] if is_numbered else accuracies
            rows["GPA"] = own
        found.append((GnssFlag.SECOND if place else GnssFlag.NONE, rows))
    return found


def _gnss(tables: Columns, flag: GnssFlag) -> Arrivals:
    if (rows := rows_of(tables, "GPS")) is None:
        return []
    table, t_ns = rows
    names = names_of(table)
    n = len(table)
    is_fix = (table["Status"] >= FIX_3D) & is_place(table["Lat"], table["Lng"])
    dop = table["HDop"] if "HDop" in names else np.full(n, 1.0)
    std_h = np.maximum(GNSS_STD_MIN, dop * GNSS_STD_PER_DOP)
    std_v, std_vel = GNSS_STD_RATIO * std_h, np.full(n, GNSS_STD_VEL)
    down = np.asarray(table["VZ"], dtype=float) if "VZ" in names else np.full(n, np.nan)
    if (found := _accuracies(tables, t_ns)) is not None:
        gpa, is_there = found
        std_h = _where_known(gpa, "HAcc", is_there, std_h)
        std_v = _where_known(gpa, "VAcc", is_there, std_v)
        std_vel = _where_known(gpa, "SAcc", is_there, std_vel)
        if "VV" in names_of(gpa):
            down = np.where(is_there & (gpa["VV"] == 0), np.nan, down)
        if "SMS" in names_of(gpa):
            sample_ns = np.asarray(gpa["SMS"], dtype=np.int64) * 1_000_000
            is_there = is_there & (np.abs(sample_ns - t_ns) < SAMPLE_TIME_NS) & (sample_ns > 0)
            t_ns = np.where(is_there, sample_ns, t_ns)
    course = np.deg2rad(np.asarray(table["GCrs"], dtype=float))
    speed = np.asarray(table["Spd"], dtype=float)
    position = (np.deg2rad(table["Lat"]), so3.wrap(np.deg2rad(table["Lng"])), table["Alt"])
    velocity = (speed * np.cos(course), speed * np.sin(course), down)
    stds = (std_h, std_v, std_vel)
    events = EventColumns(t_ns, Kind.GNSS, *position, *velocity, *stds, np.nan, float(flag))
    return [(events.take(is_fix), table[OFFSET][is_fix])] if is_fix.any() else []


def _where_known(gpa: Column, name: str, is_there: Mask, otherwise: Array) -> Array:
    """Return an accuracy where the receiver reported one: 0 and the largest number mean none."""
    value = np.asarray(gpa[name], dtype=float) if name in names_of(gpa) else np.zeros(len(gpa))
    return series.accuracy(np.where(is_there & (value < 655.0), value, 0.0), otherwise)


def _gnss_heading(tables: Columns) -> Arrivals:
    if (rows := rows_of(tables, "GPS")) is None or "Yaw" not in names_of(rows[0]):
        return []
    table, t_ns = rows
    # 0 is "no yaw"; a receiver sends 360 for north
    valid = (table["Status"] >= FIX_3D) & (table["Yaw"] != 0.0) & np.isfinite(table["Yaw"])
    std = np.full(len(table), GNSS_HEADING_STD)
    if (found := _accuracies(tables, t_ns)) is not None:
        std = np.deg2rad(_where_known(found[0], "YAcc", found[1], np.rad2deg(std)))
    return _heading(t_ns[valid], table[valid], std[valid], HeadingSource.GNSS)


def _attitude_heading(tables: Columns) -> Arrivals:
    if (rows := rows_of(tables, "ATT")) is None:
        return []
    stride = series.thinned(rows[1], HEADING_RATE)
    table, t_ns = rows[0][stride], rows[1][stride]
    std = np.full(len(table), HEADING_STD)
    return _heading(t_ns, table, std, HeadingSource.AUTOPILOT)


def _heading(t_ns: Stamps, table: Column, std: Array, source: HeadingSource) -> Arrivals:
    if len(table) == 0:
        return []
    heading = so3.wrap(np.deg2rad(np.asarray(table["Yaw"], dtype=float)))
    events = EventColumns(t_ns, Kind.HEADING, heading, std, float(source))
    return [(events, table[OFFSET])]


class _Magnetometer:
    """Makes events of MAG rows, with the compass of each: 0 is the one that is used first."""

    def __init__(self, table: StoredRows | None) -> None:
        is_numbered = table is not None and len(table) and INSTANCE in table.names
        self._first = int(table.read(0, 1)[INSTANCE][0]) if table and is_numbered else None

    def __call__(self, tables: Columns) -> Arrivals:
        """Return the events of some rows."""
        if (rows := rows_of(tables, "MAG")) is None:
            return []
        table, t_ns = rows
        field = np.stack([table[name] for name in NEEDED["MAG"]], axis=1) * 1e-3  # mGauss
        healthy = np.ones(len(table), dtype=bool)
        if "Health" in names_of(table):
            healthy &= table["Health"] != 0
        compass = np.zeros(len(table))
        if self._first is not None:
            number = table[INSTANCE]
            compass = np.where(number == self._first, 0.0, number + 1.0)
        events = EventColumns(t_ns, Kind.MAG, *field.T, compass)
        return [(events.take(healthy), table[OFFSET][healthy])] if healthy.any() else []


def _vehicle(tables: Columns, stored: Tables) -> Arrivals:
    """Return armed and landed as events, one at each change, from ARM and EV rows.

    With how the vehicle moves.
    """
    changes: list[tuple[int, int, str, bool]] = []  # place, stamp, what, value
    if "ARM" in tables and (t_ns := boot_ns(tables["ARM"])) is not None:
        for row, stamp in zip(tables["ARM"], t_ns, strict=True):
            changes.append((int(row[OFFSET]), int(stamp), "armed", bool(row["ArmState"])))
    if "EV" in tables:
        table = tables["EV"]
        for row, stamp in zip(table, _stamps_by_place(stored, table), strict=True):
            if int(row["Id"]) in _EVENTS:
                changes.append((int(row[OFFSET]), int(stamp), *_EVENTS[int(row["Id"])]))
    state = {"armed": np.nan, "landed": np.nan}
    rows = []
    for place, stamp, what, value in sorted(changes):
        is_new = state[what] != value
        state[what] = float(value)
        if is_new and np.isfinite(state["armed"]):
            rows.append((place, stamp, *state.values()))
    if not rows:
        return []
    places, stamps, armed, landed = zip(*rows, strict=True)
    moves = float(_moves(tables))
    events = EventColumns(np.array(stamps), Kind.VEHICLE, armed, landed, 0.0, 0.0, moves)
    return [(events, np.array(places))]


def _stamps_by_place(stored: Tables, table: Column) -> Stamps:
    """Return the rows' own stamps or, for old rows without, those of the IMU rows before them."""
    if (own := boot_ns(table)) is not None:
        return own
    stamps: Stamps | None = None
    for _, part in stored["IMU"].parts() if "IMU" in stored else ():
        if (rows := rows_of({"IMU": part}, "IMU")) is not None:
            before = np.searchsorted(rows[0][OFFSET], table[OFFSET]) - 1
            stamps = np.full(len(table), rows[1][0]) if stamps is None else stamps
            stamps = np.where(before < 0, stamps, rows[1][before])
    return np.zeros(len(table), dtype=np.int64) if stamps is None else stamps


def _is_submarine(tables: Columns) -> bool:
    """Return whether the firmware names itself ArduSub."""
    if "MSG" not in tables or "Message" not in names_of(tables["MSG"]):
        return False
    return any(bytes(words).startswith(b"ArduSub") for words in tables["MSG"]["Message"])


def _moves(tables: Columns) -> VehicleType:
    """Return how the vehicle moves, by what its firmware names itself."""
    if "MSG" not in tables or "Message" not in names_of(tables["MSG"]):
        return VehicleType.UNKNOWN
    for words in tables["MSG"]["Message"]:
        for name, moves in _FIRMWARES.items():
            if bytes(words).startswith(name):
                can_hover = moves is VehicleType.FIXED_WING and parameter(tables, "Q_ENABLE")
                return VehicleType.OTHER if can_hover else moves
    return VehicleType.UNKNOWN


def _to_vehicle(tables: Columns, notes: list[str]) -> Callable[[Arrivals], Arrivals]:
    """Return the rotation of samples and magnetic fields from the board to the vehicle.

    The log has them in the axes of the board.
    """
    roll, pitch = (parameter(tables, name) or 0.0 for name in ("AHRS_TRIM_X", "AHRS_TRIM_Y"))
    if not (roll or pitch):
        return lambda arrivals: arrivals
    C_vb = trim_matrix(roll, pitch)
    notes.append(
        f"the board is mounted at roll {np.degrees(roll):.1f} and pitch {np.degrees(pitch):.1f} "
        "deg (AHRS_TRIM): its samples are turned into the axes of the vehicle"
    )

    def turned(events: EventColumns) -> EventColumns:
        if events.kind in (Kind.IMU, Kind.MAG):
            events = events.rotated(0, C_vb)
        return events.rotated(3, C_vb) if events.kind == Kind.IMU else events

    return lambda arrivals: [(turned(events), places) for events, places in arrivals]


def _gnss_delay(tables: Columns) -> float | None:
    """Return the GNSS delay where a parameter sets one; 0 leaves it to the driver."""
    for name in ("GPS1_DELAY_MS", "GPS_DELAY_MS"):
        if (delay := parameter(tables, name)) is not None and delay > 0.0:
            return delay * 1e-3
    return None

"""Source of each aid, since when, and why one is refused; and the attitude's drift at rest.

Called twice a second; the counts show what became of an aid in between.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

from ekf_companion.core.memory.aid import BY_KIND, DECLARED
from ekf_companion.core.memory.enums import Azimuth
from ekf_companion.core.memory.overlay import as_estimate
from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.mavlink.decode import heading, inertial
from ekf_companion.mavlink.decode.aids import SOURCES
from ekf_companion.mavlink.decode.air import PRESSURE_SOURCES
from ekf_companion.mavlink.decode.heading import wrap
from ekf_companion.mavlink.session import Session
from ekf_companion.mavlink.stamp import SECOND_NS, seconds_since
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import Status
from ekf_companion.status.vehicle import NO_DRIFT, AidState, Drift

_log = logging.getLogger(__name__)

LAPSE_NS = 3 * SECOND_NS
"""An aid that was not used for so long counts as lost: a slow receiver has one fix a second, and a
single refusal is not worth reporting."""
PAUSE_NS = 60 * SECOND_NS
"""Time without a refusal after which the next one is logged again."""
REST_SPAN_NS = 20 * SECOND_NS
"""Length of rest over which the attitude is compared."""
SETTLED_NS = 5 * SECOND_NS
"""After an alignment the first fixes and the learning of the biases move the attitude."""

_WHY = {
    Verdict.GATED: "outside its gate",
    Verdict.SUSPECT: "the receiver reports jamming or spoofing",
    Verdict.DISTURBED: "the magnetic field is not the Earth's",
    Verdict.DENIED: "contradicted by other evidence",
}
"""Verdicts that refuse, in words."""
_NO_FIELD = "mag: no field of the Earth"


@dataclass(slots=True)
class _Watched:
    """State of one aid."""

    used: float
    """How often it was used."""
    refused: Mapping[Verdict, int]
    """How often it was refused, by reason."""
    source: str = ""
    since_ns: int = 0
    used_ns: int | None = None
    refused_ns: int | None = None
    why: str = ""


class AidWatch:
    """The aids of one pipeline, and the attitude at rest."""

    def __init__(self) -> None:
        self._pipeline: Pipeline | None = None
        self._aids: dict[Aid, _Watched] = {}
        self._level: deque[tuple[int, float, float, float]] = deque()
        """When, ns, and roll, pitch, yaw, rad, of one rest."""
        self._settled_ns: int | None = None
        self._begun = (0.0, 0.0)
        """Source of the azimuth and number of resets."""

    def update(self, pipeline: Pipeline, session: Session, now_ns: int) -> None:
        """Update the aids from the counts since the last call, and the attitude."""
        x = pipeline.filter_state
        is_autopilots, ranks = bool(x.fix_t > x.raw_fix_t), session.decoder.ranks
        sources = sources_of(
            int(x.azimuth), is_autopilots=is_autopilots, ranks=ranks, receiver=int(x.receiver)
        )
        airspeed = BY_KIND[Kind.AIRSPEED].sensor
        sources[Aid["AIRSPEED"]] = f"{session.decoder.airspeed_source}, {airspeed}"
        for kind, sender in session.decoder.external.used.items():
            declared = BY_KIND[kind]
            sources[Aid[declared.name.upper()]] = f"{sender}, {declared.sensor}"
        used = {aid: x.count[aid][Verdict.FUSED] + x.count[aid][Verdict.DEWEIGHTED] for aid in Aid}
        refused = {aid: {why: int(x.count[aid][why]) for why in _WHY} for aid in Aid}
        refused[Aid.HEADING][Verdict.DISTURBED] += session.decoder.refused[_NO_FIELD]
        unused = {aid: one.words for one in pipeline.wrong_now() for aid in one.unused}
        if pipeline is not self._pipeline or any(used[aid] < self._aids[aid].used for aid in Aid):
            self._pipeline = pipeline
            self._aids = {aid: _Watched(used[aid], refused[aid]) for aid in Aid}
            self._level.clear()
            self._settled_ns = None
        for aid, one in self._aids.items():
            if used[aid] > one.used and aid in unused:  # at no weight
                one.refused_ns, one.why = now_ns, f"suspected: {unused[aid]}"
            elif used[aid] > one.used:
                _use(one, sources[aid], now_ns)
            for why, count in refused[aid].items():
                if count > one.refused[why]:
                    _refuse(one, why, now_ns)
            one.used, one.refused = used[aid], refused[aid]
        # Another source, a declination that becomes known, or a reset move it at once
        begun = (x.azimuth, x.resets)
        is_same, self._begun = begun == self._begun, begun
        self._watch_level(pipeline, is_at_rest=is_same and bool(x.at_rest), now_ns=now_ns)

    def _watch_level(self, pipeline: Pipeline, *, is_at_rest: bool, now_ns: int) -> None:
        values = pipeline.values()
        if not is_at_rest or int(as_estimate(values).status) < Status.ATTITUDE:
            self._level.clear()
            self._settled_ns = None
            return
        if self._settled_ns is None:
            self._settled_ns = now_ns + SETTLED_NS
        if now_ns < self._settled_ns:
            return
        if self._level and now_ns - self._level[-1][0] < SECOND_NS // 4:
            return
        roll, pitch, yaw = values[13:16].tolist()
        self._level.append((now_ns, roll, pitch, yaw))
        while now_ns - self._level[0][0] > REST_SPAN_NS:
            self._level.popleft()

    def states(self, now_ns: int) -> Mapping[str, AidState]:
        """Return the state of each aid by its name."""
        return {aid.name.lower(): _state(one, now_ns) for aid, one in self._aids.items()}

    def drift(self) -> Drift:
        """Return by how much the attitude has changed in the last seconds of rest."""
        if len(self._level) < 2:
            return NO_DRIFT
        first = self._level[0]
        spreads = [
            max(turned) - min(turned)
            for axis in (1, 2, 3)
            if (turned := [wrap(one[axis] - first[axis]) for one in self._level])
        ]
        roll, pitch, heading = map(math.degrees, spreads)
        return Drift(
            seconds=(self._level[-1][0] - first[0]) * 1e-9,
            roll_deg=roll,
            pitch_deg=pitch,
            heading_deg=heading,
        )


def _use(one: _Watched, source: str, now_ns: int) -> None:
    """Note that an aid was used; a source counts from its first use after a break."""
    is_break = one.used_ns is None or now_ns - one.used_ns > LAPSE_NS
    if is_break or source != one.source:
        one.source, one.since_ns = source, now_ns
    one.used_ns = now_ns


def _refuse(one: _Watched, why: Verdict, now_ns: int) -> None:
    """Note that an aid was refused; of a compass, log where that begins."""
    is_first = one.refused_ns is None or now_ns - one.refused_ns > PAUSE_NS
    if why is Verdict.DISTURBED and (is_first or one.why != _WHY[why]):
        _log.info("Compass refused, always or at times: %s; counted as disturbed", _WHY[why])
    one.refused_ns, one.why = now_ns, _WHY[why]


def _state(one: _Watched, now_ns: int) -> AidState:
    used_s, refused_s = seconds_since(one.used_ns, now_ns), seconds_since(one.refused_ns, now_ns)
    limit = LAPSE_NS * 1e-9
    is_used = used_s <= limit
    is_refused = not is_used and refused_s <= limit
    state = "used" if is_used else "refused" if is_refused else "lost" if one.source else "none"
    return AidState(
        source=one.source,
        state=state,
        since_s=seconds_since(one.since_ns, now_ns) if is_used else math.nan,
        used_s=used_s,
        refused_s=refused_s,
        why=one.why,
    )


def sources_of(
    azimuth: int, *, is_autopilots: bool, ranks: tuple[int, ...], receiver: int
) -> dict[Aid, str]:
    """Return the source of each aid, by the ranks of the sources and the receiver in use."""
    _, mag, baro, azimuth_rank = ranks
    fixes = "GPS2_RAW" if receiver else "GPS_RAW_INT"
    messages = {**SOURCES, Kind.BARO: PRESSURE_SOURCES[baro]}
    position = "GLOBAL_POSITION_INT, the autopilot's own" if is_autopilots else fixes
    by_azimuth = {
        Azimuth.ANTENNA: f"{fixes}, two antennas",
        Azimuth.OTHER: f"{heading.SOURCES[azimuth_rank]}, the autopilot's own",
        Azimuth.MAGNETIC: f"{inertial.SOURCES[mag]}, magnetometer",
        Azimuth.FIELD: f"{inertial.SOURCES[mag]}, magnetometer",
    }
    return {
        Aid.POSITION: position,
        Aid.HEIGHT: position,
        Aid.VELOCITY: position,
        Aid.HEADING: by_azimuth.get(Azimuth(azimuth), "") if azimuth else "",
        Aid.REST: "the inertial samples",
        **{
            Aid[one.name.upper()]: ", ".join(filter(None, (messages.get(one.kind), one.sensor)))
            for one in DECLARED
        },
    }

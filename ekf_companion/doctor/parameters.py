"""The autopilot's parameters that the guard does not read and the doctor needs.

The parameters that decide on ODOMETRY are requested here only if the guard requests none, because
its mode needs no decision.

Sources: PX4's and ArduPilot's parameter references.
"""

from __future__ import annotations

from collections.abc import Mapping

from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.fusion import NAMES, missing

FURTHER: Mapping[Family, tuple[str, ...]] = {
    Family.PX4: (
        *("EKF2_EV_QMIN", "EKF2_EV_DELAY", "EKF2_HGT_REF"),
        *("IMU_INTEG_RATE", "MAV_0_RATE", "MAV_1_RATE", "MAV_2_RATE"),
    ),
    Family.ARDUPILOT: ("VISO_QUAL_MIN", "SCHED_LOOP_RATE"),
    Family.UNKNOWN: (),
}
_PERIOD_NS = 40_000_000
"""Time between two requests: a second for all, and little traffic beside the streams."""
_TIMEOUT_NS = 1_000_000_000
_TRIES = 3


class ParameterReader:
    """Collects parameters that come, and requests those that nobody else does; clockless."""

    def __init__(self) -> None:
        self.answers: dict[str, float | None] = {}
        """Values by name; None: the autopilot has no such parameter."""
        self._family = Family.UNKNOWN
        self._is_deciding = False
        self._asked: dict[str, tuple[int, int]] = {}
        """How often each was asked for, and until when its answer is waited for, ns."""
        self._next_ns = 0

    @property
    def values(self) -> dict[str, float]:
        """The values that the autopilot has sent."""
        return {name: value for name, value in self.answers.items() if value is not None}

    @property
    def is_done(self) -> bool:
        """Whether each one has been answered or given up."""
        return all(self._asked.get(name, (0, 0))[0] > _TRIES for name in self._open())

    def begin(self, family: Family, *, is_deciding: bool) -> None:
        """Ask an autopilot of this family; if ``is_deciding``, also for what the guard needs."""
        self._family, self._is_deciding = family, is_deciding

    def receive(self, name: str, value: float | None, family: Family) -> None:
        """Keep an answer, whoever asked; None: there is no such parameter."""
        if name in NAMES[family] or name in FURTHER[family]:
            self.answers[name] = value

    def request(self, system_id: int, component_id: int, now_ns: int) -> bytes | None:
        """Return the payload of the PARAM_REQUEST_READ that is due; None if none is."""
        if now_ns < self._next_ns:
            return None
        for name in self._open():
            tries, deadline_ns = self._asked.get(name, (0, 0))
            if now_ns < deadline_ns or tries > _TRIES:
                continue
            self._asked[name] = tries + 1, now_ns + _TIMEOUT_NS
            # After the last try only the answer is waited for
            if tries == _TRIES:
                continue
            self._next_ns = now_ns + _PERIOD_NS
            return pack(
                "PARAM_REQUEST_READ",
                target_system=system_id,
                target_component=component_id,
                param_id=name.encode(),
                param_index=-1,
            )
        return None

    def _open(self) -> list[str]:
        """Return the parameters that have not been answered yet."""
        deciding = missing(self._family, self.answers) if self._is_deciding else ()
        names = (*deciding, *FURTHER[self._family])
        return [name for name in names if name not in self.answers]

"""Which frames are let in: by system and component id, and by signature."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection

from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.messages import IDS
from ekf_companion.mavlink.signing import Signing
from ekf_companion.mavlink.stamp import SECOND_NS

SETUP_SIGNING = IDS["SETUP_SIGNING"]
"""Refused from everybody: it carries a secret, and our key is given to us in a file."""
_RADIO_STATUS = IDS["RADIO_STATUS"]
_RADIO = 68
"""MAV_COMP_ID_TELEMETRY_RADIO."""

RADIO_NS = SECOND_NS // 10
"""Between two frames of a telemetry radio, at least: it sends one or two a second."""

SYSTEM = "system is not in link.allow_systems"
COMPONENT = "component is not in link.allow_components"
UNSIGNED = "not signed"
SECRET = "carries a secret"


class Admission:
    """Lets frames in, and counts those that it refuses by reason."""

    def __init__(
        self,
        systems: Collection[int] = (),
        components: Collection[int] = (),
        signing: Signing | None = None,
        accept_unsigned: bool = False,
    ) -> None:
        """Let in these ids (empty: all), and with ``signing`` only frames whose signature is right.

        With ``accept_unsigned``, frames without a signature are let in too.
        """
        self.refused: Counter[str] = Counter()
        """Frames by the reason why not."""
        self._systems = frozenset(systems)
        self._components = frozenset(components)
        self._signing = signing
        self._accept_unsigned = accept_unsigned
        self._radio_ns = -RADIO_NS
        self.is_selective = bool(systems or components or signing)
        """Whether any frame but SETUP_SIGNING may be refused."""

    @property
    def signed(self) -> int:
        """How many frames had a signature that was right."""
        return 0 if self._signing is None else self._signing.verified

    def is_proven(self, frame: Frame) -> bool:
        """Whether an admitted frame says who sent it as surely as is asked of all."""
        return self._signing is None or self._accept_unsigned or frame.is_signed

    def refuse(self, frame: Frame, now_ns: int, *, is_beside_autopilot: bool = False) -> str:
        """Count and return the reason why a frame is not let in; empty if it is.

        Args:
            frame: With a right checksum.
            now_ns: Unix time.
            is_beside_autopilot: Whether it came by the way on which the autopilot is heard.
        """
        reason = self._judge(frame, now_ns)
        if reason == UNSIGNED and is_beside_autopilot and self._is_of_radio(frame, now_ns):
            return ""
        if reason:
            self.refused[reason] += 1
        return reason

    def _judge(self, frame: Frame, now_ns: int) -> str:
        if self._systems and frame.system_id not in self._systems:
            return SYSTEM
        if self._components and frame.component_id not in self._components:
            return COMPONENT
        if frame.message_id == SETUP_SIGNING:
            return SECRET
        if self._signing is None:
            return ""
        if frame.is_signed:
            return self._signing.verify(frame, now_ns)
        return "" if self._accept_unsigned else UNSIGNED

    def _is_of_radio(self, frame: Frame, now_ns: int) -> bool:
        """Whether it is a telemetry radio's RADIO_STATUS, no more often than a radio sends it.

        A radio knows no secret, and what it says decides nothing here.
        """
        if frame.message_id != _RADIO_STATUS or frame.component_id != _RADIO:
            return False
        if 0 <= now_ns - self._radio_ns < RADIO_NS:
            return False
        self._radio_ns = now_ns
        return True

"""What the pilot reads, and how often: one text a minute of a kind, and at once what is grave.

A pilot's screen holds a few lines, and a text that comes every second hides the others. So of what
happens again and again the first is sent at once, and the others are counted into one text a minute
later. A state, as that of the estimate, is sent when it begins; one that comes back within the
minute waits, and is sent then if it still holds. All of them are in the log.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.mavlink.statustext import Severity

MINUTE_NS = 60 * SECOND_NS
"""Between two texts of a kind."""


@dataclass(frozen=True, slots=True)
class _State:
    """A state of a subject, which waits to be sent."""

    key: str
    severity: Severity
    text: str
    is_end: bool


@dataclass(slots=True)
class _LeftOut:
    """Occurrences of one kind that were not sent."""

    severity: Severity
    one: str
    many: str
    """With ``{}`` for their number."""
    size: float
    """Of the largest, whose words those are."""
    count: int


class PilotTexts:
    """Sends texts, each kind once a minute."""

    def __init__(self, send: Callable[[Severity, str], None]) -> None:
        """Begin with nothing sent; ``send`` takes a text for the pilot."""
        self._send = send
        self._shown: dict[str, str] = {}
        """Of each subject, the key of the state that was sent last."""
        self._sent_ns: dict[tuple[str, str], int] = {}
        """When a state, or an occurrence (with an empty key), was sent last."""
        self._renewed_ns: dict[str, int] = {}
        """From when on a subject that is well again renews its other states without a text."""
        self._states: dict[str, _State] = {}
        self._left_out: dict[str, _LeftOut] = {}

    def on_state(
        self,
        subject: str,
        key: str,
        severity: Severity,
        text: str,
        now_ns: int,
        *,
        is_grave: bool = False,
        is_end: bool = False,
    ) -> None:
        """Send that a subject is in another state: at once where it is grave, or not sent lately.

        Args:
            subject: Whose state.
            key: Tells the states apart; a text may have numbers that change meanwhile.
            severity: How grave it is.
            text: What is sent.
            now_ns: Since when.
            is_grave: Whether it is sent at once, however often.
            is_end: Whether all is well again: when that was sent, what comes after is news.
        """
        self._states.pop(subject, None)
        if self._shown.get(subject) == key:
            return
        if not is_grave and not self._may_send((subject, key), now_ns):
            self._states[subject] = _State(key, severity, text, is_end)
            if is_end and now_ns >= self._renewed_ns.get(subject, now_ns):
                # Once a minute what comes next is news although this is not sent
                self._renewed_ns[subject] = now_ns + MINUTE_NS
                self._shown[subject] = key
                self._renew(subject, key)
            return
        if is_end:
            self._renew(subject, key)
        self._shown[subject] = key
        self._sent_ns[subject, key] = now_ns
        self._send(severity, text)

    def _renew(self, subject: str, key: str) -> None:
        """Take any other state of a subject for news when it comes."""
        for kind in [kind for kind in self._sent_ns if kind[0] == subject and kind[1] != key]:
            del self._sent_ns[kind]

    def shown(self, subject: str) -> str:
        """Return the key of the state that was sent last of a subject; empty: none was."""
        return self._shown.get(subject, "")

    def withdraw(self, subject: str) -> None:
        """Send no state that waits: it holds no longer."""
        self._states.pop(subject, None)

    def assume(self, subject: str, key: str) -> None:
        """Take a state for sent: it needs no text."""
        self._shown[subject] = key
        self._states.pop(subject, None)

    def forget(self) -> None:
        """Send each state again: whoever listens now may not have heard the last."""
        self._shown.clear()
        self._states.clear()

    def on_occurrence(
        self,
        subject: str,
        severity: Severity,
        text: str,
        now_ns: int,
        *,
        many: str = "",
        size: float = 0.0,
        count: int = 1,
    ) -> None:
        """Send that something has happened, or count it where one of its kind was sent lately.

        Args:
            subject: Its kind.
            severity: How grave it is.
            text: What is sent of one.
            now_ns: When.
            many: What is sent of several, with ``{}`` for their number; empty: the text of the
                last, as of a value that was set again.
            size: Of several, the words of the largest are sent.
            count: How many they are.
        """
        left = self._left_out.get(subject)
        if left is None:
            left = _LeftOut(severity, text, many, size, 0)
            self._left_out[subject] = left
        left.count += count
        left.severity = min(left.severity, severity)
        if size >= left.size:
            left.one, left.many, left.size = text, many, size
        self._send_occurrence(subject, now_ns)

    def tick(self, now_ns: int) -> None:
        """Send what has waited for a minute."""
        for subject in list(self._left_out):
            self._send_occurrence(subject, now_ns)
        for subject, state in list(self._states.items()):
            if self._may_send((subject, state.key), now_ns):
                key, severity, text, is_end = state.key, state.severity, state.text, state.is_end
                self.on_state(subject, key, severity, text, now_ns, is_end=is_end)

    def _send_occurrence(self, subject: str, now_ns: int) -> None:
        if not self._may_send((subject, ""), now_ns):
            return
        left = self._left_out.pop(subject)
        self._sent_ns[subject, ""] = now_ns
        text = left.many.format(left.count) if left.many and left.count > 1 else left.one
        self._send(left.severity, text)

    def _may_send(self, kind: tuple[str, str], now_ns: int) -> bool:
        sent_ns = self._sent_ns.get(kind)
        return sent_ns is None or not 0 <= now_ns - sent_ns < MINUTE_NS

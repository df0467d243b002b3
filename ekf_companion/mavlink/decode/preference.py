"""The choice among several sources of one thing, and the thinning of a stream, by their stamps."""

from __future__ import annotations

from ekf_companion.mavlink.stamp import SECOND_NS, Stamp

ABSENT_NS = 3 * SECOND_NS
"""A better source must be silent for so long before the next one is used."""
STEADY_NS = SECOND_NS
"""A better source must speak steadily for so long before it is used instead of a worse one."""
_SHARE = 0.5
"""The better source must bring this share of the messages of the one in use: a message that was
requested once, or once a second, is none to fly on."""
_BURST = 8
"""Messages of the source in use behind one another; a steady source has spoken in between."""


class _Challenger:
    """What is known of a source that is not in use, since it began to speak."""

    def __init__(self, t_ns: Stamp, used: int) -> None:
        self.first_ns, self.count = t_ns, 1
        self.used = self.since = used
        """Messages of the source in use until it began, and until it last spoke."""


class Preference:
    """Uses, of several sources of one thing, the best that speaks steadily, by their own stamps.

    At the start the best is waited for.
    """

    def __init__(self, starving: float = 0.0) -> None:
        """Begin with the best.

        A source in use that brings less than the share ``starving`` of the messages of a worse one,
        for three seconds, counts as silent.
        """
        self.rank = 0
        """Of the source in use: 0 is the best."""
        self.sole = 0
        """The same while no other source speaks: :meth:`admit` need not be asked then; else -1."""
        self._starving = starving
        self._used = 0
        """Messages of the source in use, counted while others speak."""
        self._waiting_ns: int | None = None
        """When a worse source first spoke since the one in use last did.

        Counted from there, so that a link's silence speaks against no source.
        """
        self._challengers: dict[int, _Challenger] = {}

    def use(self, rank: int) -> None:
        """Use the source of this rank at once: better ones are known to be silent."""
        self.rank = rank
        self.sole = -1 if self._challengers else rank

    def admit(self, rank: int, t_ns: Stamp) -> bool:
        """Whether to use a source now, by its rank and its own stamp."""
        if rank == self.rank:
            self._used += 1
            self._waiting_ns = None
            return True
        one = self._challengers.get(rank)
        if one is None or t_ns < one.first_ns:
            one = self._challengers[rank] = _Challenger(t_ns, self._used)
            self.sole = -1
        else:
            one.count += 1
        is_taken = self._is_steady(one, t_ns) if rank < self.rank else self._is_needed(one, t_ns)
        if is_taken:
            self._challengers.clear()
            self._used, self._waiting_ns = 0, None
            self.use(rank)
        return is_taken

    def _is_steady(self, one: _Challenger, t_ns: Stamp) -> bool:
        """Whether a better source has spoken long and often enough; if not, watch it anew."""
        used, is_burst = self._used - one.used, self._used - one.since > _BURST
        one.since = self._used
        if not is_burst and t_ns - one.first_ns < STEADY_NS:
            return False
        if not is_burst and one.count > _SHARE * used:
            return True
        one.first_ns, one.count, one.used = t_ns, 1, self._used
        return False

    def _is_needed(self, one: _Challenger, t_ns: Stamp) -> bool:
        """Whether the source in use is silent, or as good as silent beside a worse one."""
        if self._waiting_ns is None or t_ns < self._waiting_ns:
            self._waiting_ns = t_ns
        if t_ns - self._waiting_ns > ABSENT_NS:
            return True
        if t_ns - one.first_ns <= ABSENT_NS:
            return False
        is_starving = self._used - one.used < self._starving * one.count
        one.first_ns, one.count, one.used = t_ns, 1, self._used
        return is_starving


class Pace:
    """Thins a stream to a rate by its own stamps."""

    def __init__(self, rate: float) -> None:
        self._period_ns = round(SECOND_NS / rate * 0.99)  # stamps jitter
        self._last_ns: Stamp | None = None

    def is_due(self, t_ns: Stamp) -> bool:
        """Whether a period has passed since the last that was admitted."""
        return self._last_ns is None or not 0 <= t_ns - self._last_ns < self._period_ns

    def admit(self, t_ns: Stamp) -> bool:
        """Admit one if a period has passed since the last that was; return whether."""
        if not self.is_due(t_ns):
            return False
        self._last_ns = t_ns
        return True

"""Measured rates of messages, and why one probably comes too rarely."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from statistics import median

from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import Emit, PeerFound, RateTooLow
from ekf_companion.mavlink.messages import LAYOUTS
from ekf_companion.mavlink.request import ACCEPTED, NO_ANSWER, Requests
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS, quantise

INERTIAL = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")
"""Messages that inertial samples may come in."""
_GNSS = "GPS_RAW_INT"

_RECEIVER = {
    Family.ARDUPILOT: "GPS1_TYPE (GPS_TYPE), SERIALn_PROTOCOL 5, SRn_EXT_STAT",
    Family.PX4: "GPS_1_CONFIG, SER_GPS1_BAUD, MAV_n_MODE",
}
"""Parameters that decide whether there is a receiver, and whether what it says is streamed."""
_STREAM = {Family.ARDUPILOT: "SRn_RAW_SENS = 50", Family.PX4: "MAV_n_MODE = 2 (Onboard)"}
"""Parameters that have the inertial samples sent."""

_STEP_NS = SECOND_NS
_STEPS = 5
"""Rates are means over so many steps."""
_SHARE = 0.5
"""Of the requested rate; less is too rare. An autopilot that divides its rate gives more."""
_AGAIN_NS = 10 * SECOND_NS
_RESIGNED_NS = 60 * SECOND_NS
"""Between two requests for the same message, at first and later."""
_TRIES = 3


class Audit(Service):
    """Measures the rate of every message, and requests inertial samples and fixes that are missing.

    Other messages may come at any rate: the filter can do without them.
    """

    def __init__(self, received: Counter[int], requests: Requests, emit: Emit) -> None:
        self.rates: dict[str, float] = {}
        """Of each message of the autopilot over the last five seconds, Hz."""
        self._received = received
        self._requests = requests
        self._emit = emit
        self.begin(PeerFound(0, 0, Family.UNKNOWN))

    def begin(self, peer: PeerFound) -> None:
        """Measure anew."""
        self._family = peer.family
        self.causes: dict[str, str] = {}
        """Probable causes by message, where one comes too rarely however often it is requested."""
        self._steps: deque[tuple[int, dict[int, int]]] = deque(maxlen=_STEPS + 1)
        self._settled = 0
        self._tries: Counter[str] = Counter()
        self._next_ns: dict[str, int] = {}

    def tick(self, now_ns: int) -> None:
        """Count once a second; judge the rates five seconds after the last request for them.

        Those for other messages do not count: on a full line they take a minute.
        """
        now_ns = quantise(now_ns)
        if self._steps and now_ns - self._steps[-1][0] < _STEP_NS:
            return
        self._steps.append((now_ns, dict(self._received)))
        first_ns, before = self._steps[0]
        if now_ns > first_ns:
            span = (now_ns - first_ns) * 1e-9
            self.rates = {
                LAYOUTS[number].name: (count - before.get(number, 0)) / span
                for number, count in self._received.items()
            }
        is_asked = self._requests.is_under_way((*INERTIAL[:2], _GNSS))
        self._settled = 0 if is_asked else self._settled + 1
        if self._settled > _STEPS:
            self._judge(now_ns)

    def _judge(self, now_ns: int) -> None:
        in_use = max(INERTIAL, key=lambda name: self.rates.get(name, 0.0))
        inertial = self.rates.get(in_use, 0.0)
        name = self._requests.inertial or (in_use if in_use == "RAW_IMU" else "HIGHRES_IMU")
        is_low = inertial < _SHARE * self._requests.expected_rate(name)
        is_starved = inertial > 0.0 and self.rates.get(_GNSS, 0.0) == 0.0
        # What comes of it leaves no room for fixes
        if is_low and self._tries[name] and is_starved and self._requests.lower(name, inertial):
            return
        self._judge_rate(name, is_low, now_ns)
        # The receiver decides its rate; only silence is a fault
        self._judge_rate(_GNSS, self.rates.get(_GNSS, 0.0) == 0.0, now_ns)

    def _judge_rate(self, name: str, is_low: bool, now_ns: int) -> None:
        asked = self._requests.expected_rate(name)
        if asked <= 0.0:
            return
        if not is_low:
            self._tries.pop(name, None)
            self.causes.pop(name, None)
            return
        if now_ns < self._next_ns.get(name, now_ns):
            return
        self._tries[name] += 1
        if self._tries[name] == _TRIES + 1:
            results = self._requests.results
            if name == _GNSS:
                cause = silence_cause(results.get(name, ""), self._family)
            elif not any(self.rates.get(one, 0.0) for one in INERTIAL):
                cause = no_samples_cause(results, self._family)
            else:
                cause = probable_cause(self.rates, self._requests.rates, self._family)
            self.causes[name] = cause
            self._emit(RateTooLow(name, asked, self.rates.get(name, 0.0), cause))
        self._next_ns[name] = now_ns + (_AGAIN_NS if self._tries[name] <= _TRIES else _RESIGNED_NS)
        self._requests.repeat(name)


def silence_cause(result: str, family: Family) -> str:
    """Return why probably no GNSS message comes, and what to check, given our request's answer."""
    setting = _RECEIVER.get(family, "the receiver's port and this link's streams")
    answer = "" if result in ("", ACCEPTED) else f" (request: {result})"
    return f"no receiver, or its stream is off{answer}; see {setting}"


def no_samples_cause(results: Mapping[str, str], family: Family) -> str:
    """Return why probably no inertial sample comes, by the answers to our requests."""
    if results and {*results.values()} == {NO_ANSWER}:
        return (
            "it answers none of our requests, so it does not hear us: check our TX wire, RTS and "
            "CTS, and that a router lets us send to it"
        )
    answers = [f"{name}: {results[name]}" for name in INERTIAL if name in results]
    request = f"requests: {', '.join(answers)}" if answers else "none comes by itself"
    return f"{request}; see {_STREAM.get(family, 'the streams of this link')}"


def probable_cause(
    measured: Mapping[str, float], asked: Mapping[str, float], family: Family
) -> str:
    """Return why messages probably come so rarely, and what to change.

    Both rates are by message, Hz.
    """
    inertial = max((measured.get(name, 0.0) for name in INERTIAL), default=0.0)
    wanted = asked.get("HIGHRES_IMU", 0.0)
    others = {
        name: measured.get(name, 0.0)
        for name, rate in asked.items()
        if name not in INERTIAL and name != _GNSS and rate >= 5.0 and measured.get(name, 0.0) > 0.0
    }
    if inertial == 0.0:
        return no_samples_cause({}, family)
    is_ardupilot = family is Family.ARDUPILOT
    rates = [inertial, *others.values()]
    usual = median(rates)
    if others and usual <= 12.0 and all(abs(rate - usual) <= 0.3 * usual for rate in rates):
        # Ground stations ask for all groups of messages at one rate, by default 4 Hz
        setting = "SRn_*, MAVn_*; SERIALn_OPTIONS" if is_ardupilot else "its stream rates"
        return f"a ground station sets {usual:.0f} Hz for all ({setting})"
    if is_ardupilot and 36.0 <= inertial <= 44.0 and wanted >= 80.0:
        return "a loop of 50 Hz sends at most 40; raise SCHED_LOOP_RATE"
    shares = [inertial / wanted, *(rate / asked[name] for name, rate in others.items())]
    if len(shares) > 1 and max(shares) < 0.8 and max(shares) <= 1.5 * min(shares):
        setting = "SERIALn_BAUD" if is_ardupilot else "MAV_n_RATE or the baud rate"
        return f"all are thinned alike, so the link is full; raise {setting}"
    setting = "SCHED_LOOP_RATE" if is_ardupilot else "IMU_INTEG_RATE or MAV_n_RATE"
    return f"the autopilot or the link gives no more; see {setting}, or lower link.imu_rate"

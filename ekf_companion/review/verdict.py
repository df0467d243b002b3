"""One sentence on an estimate of a whole log: good, fair, poor, or why it cannot be said."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from ekf_companion.core.memory.aid import DECLARED
from ekf_companion.engine.health import Aid, Verdict, fused_of, refused_of
from ekf_companion.logs.recording import counted
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.reason import to_words
from ekf_companion.nav.state import Status
from ekf_companion.review.evidence import CLEARLY, NEAR, Evidence, evidence_of, metres
from ekf_companion.review.report import SLOW, Report
from ekf_companion.review.track import Size

OFTEN, RARELY = 0.2, 0.05
"""Shares of the flight, or of the fixes, beyond which it is poor, or no more than fair."""
FAR = 5.0
"""Horizontal difference from a truth, m RMS, that is poor; beyond ``NEAR`` it is fair."""
PEAK = 2.0
"""The worst moment is named where it is that many times the RMS, and more than ``NEAR``."""
FAST_ENOUGH = 50.0
"""Inertial samples per second, Hz, below which an estimate is no more than fair."""
SHORT_S = 15.0
"""Time below which nothing can be judged, s: a filter is settling still."""
SHORT_GAP, LONG_GAP = 1.0, 5.0
"""Time without inertial samples, s, from which on it is named, and the estimate no more than fair:
nothing was estimated for so long."""
LARGEST_DAMAGE = 0.01
"""Share of a file; more that is damaged is no more than fair."""
LARGEST_LOSS = 0.05
"""Likewise of the telemetry's frames."""

AIDS = {
    Aid.HEIGHT: "receiver's heights",
    Aid.VELOCITY: "receiver's velocities",
    **{Aid[one.name.upper()]: f"{one.sensor}'s measurements" for one in DECLARED},
}
"""Aids besides the fixes, in words; the headings are judged by sensor."""
SENSORS = {
    "antennas": "headings of two antennas",
    "other": "headings of another estimate",
    "compass": "compass's headings",
}
"""Sensors of a heading, in words."""
MOST_REASONS = 2
"""Reasons of a status that the sentence names, the longest; the summary has them all."""
MOSTLY = 0.5
"""Share of the refused headings of a compass whose field is not the Earth's, from which on that is
its trouble: iron of the vehicle, which a calibration takes out, or of what is around it."""
MOST_RESETS = 2
"""More are poor."""
FEWEST = 10
"""Refused measurements of an aid from which on they are named."""


class Reasons(NamedTuple):
    """What speaks against an estimate."""

    poor: tuple[str, ...] = ()
    fair: tuple[str, ...] = ()
    aside: tuple[str, ...] = ()
    """Worth a word, and no harm."""

    @property
    def softened(self) -> Reasons:
        """The same, of an estimate that only doubts itself: no worse than fair."""
        return Reasons((), self.poor + self.fair, self.aside)


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """What a log's estimate is good for."""

    grade: str
    """``good``, ``fair``, ``poor``, ``attitude only``, ``slow`` (samples) or ``short`` (log)."""
    size: str
    """How large its horizontal error is, and by whom; without a position that of its attitude;
    empty: it is not known."""
    reasons: tuple[str, ...]
    """What speaks against it, the worst first."""
    aside: tuple[str, ...] = ()
    """What is worth a word besides."""
    place: int = 0
    """After how many of the reasons the size stands: behind what makes it poor, unless that is the
    size."""

    @property
    def sentence(self) -> str:
        """The judgement as one sentence: ``good: 0.4 m, no resets``."""
        words = [*(self.reasons or ("no resets",)), *self.aside]
        if self.size:
            words.insert(self.place, self.size)
        return f"{self.grade}: {', '.join(words)}"


def judge_log(report: Report) -> Judgement:
    """Judge a conversion by the truth in its log, else by the other references in it."""
    return judge(report, evidence_of(report))


def judge(report: Report, evidence: Evidence) -> Judgement:
    """Judge the estimate of a whole log."""
    spent = sum(report.seconds.get(one, 0.0) for one in Status if one >= Status.OK)
    whole, rate = sum(report.seconds.values()), report.rates.get(Kind.IMU, 0.0)
    parts = [_of_table(report), _of_stamps(report), _of_gap(report)]
    parts += [_of_left_out(report), _of_samples(rate), _of_file(report)]
    departure = Reasons(*map(tuple, evidence.departure.reasons()))
    if spent > 0.0:
        doubts = [_of_status(report, spent, evidence), _of_resets(report), _of_fixes(report)]
        if evidence.is_right:
            doubts[1:] = [one.softened for one in doubts[1:]]
        parts = [_of_position(evidence), *doubts, departure, _of_aids(report), *parts]
    poor, fair, aside = (tuple(words for part in parts for words in part[i]) for i in range(3))
    if whole < SHORT_S:
        words = (f"{whole:.0f} s are too few to judge",)
        return Judgement(grade="short", size="", reasons=words + poor + fair, aside=aside)
    if spent == 0.0:
        reasons = (_why_no_position(report), *poor, *departure.poor, *fair, *departure.fair)
        size, aside = evidence.departure.attitude(), aside + departure.aside
        return Judgement(grade="attitude only", size=size, reasons=reasons, aside=aside)
    if rate < SLOW:  # what else is found follows from that
        first = _of_samples(rate).fair
        rest = (*first, *departure.poor, *departure.fair)
        reasons = (
            f"{first[0]}, {evidence.departure.guess()}",
            *(one for one in poor + fair if one not in rest),
        )
        aside = tuple(one for one in aside if one not in departure.aside)
        size = _horizontal(evidence)
        return Judgement(grade="slow", size=size, reasons=reasons, aside=aside, place=1)
    grade = "poor" if poor else "fair" if fair else "good"
    place = 0 if _of_position(evidence).poor else len(poor)
    size = _size(evidence)
    return Judgement(grade=grade, size=size, reasons=poor + fair, aside=aside, place=place)


def _size(evidence: Evidence) -> str:
    """Return how large the horizontal error is, by the best witness there is, and what else is."""
    departure = evidence.departure
    words, sizes = _horizontal(evidence), departure.sizes()
    by_autopilot = evidence.truth is None and evidence.autopilot is not None
    is_same = departure.is_truth if evidence.truth is not None else by_autopilot
    if sizes and not is_same:
        sizes[-1] += f" from {departure.witness}"
    return ", ".join([words, *sizes] if words else sizes)


def _horizontal(evidence: Evidence) -> str:
    if evidence.truth is not None:
        return _words("{} RMS from the truth", evidence.truth)
    if evidence.autopilot is not None:
        words = _words("differs from the autopilot's estimate by {} RMS", evidence.autopilot)
        ours, theirs = evidence.to_fixes or (0.0, 0.0)
        if evidence.autopilot.rms > NEAR and ours * CLEARLY < theirs:
            words += f", the receiver agrees with ours ({ours:.1f} m, not {theirs:.1f} m)"
        return words
    return "" if evidence.sigma is None else _words("{} RMS by its own sigma", evidence.sigma)


def _words(words: str, size: Size) -> str:
    text = words.format(metres(size.rms, 1))
    if size.worst > max(PEAK * size.rms, NEAR):
        text += f" ({metres(size.worst, int(size.worst < 10.0))} at {size.at_s:.0f} s)"
    return text


def _of_position(evidence: Evidence) -> Reasons:
    """Judge the distance from a truth; else from the autopilot's estimate, and the own sigma."""
    if (truth := evidence.truth) is not None:
        if truth.rms > FAR:
            return Reasons(poor=(evidence.truth_elsewhere or "far from the truth",))
        return Reasons(fair=("not close to the truth",) if truth.rms > NEAR else ())
    poor: list[str] = []
    fair: list[str] = []
    if (sigma := evidence.sigma) is not None and sigma.rms > FAR:
        is_said = evidence.autopilot is None
        poor.append("unsure of its position" if is_said else _words("sigma {} RMS", sigma))
    if (apart := evidence.autopilot) is not None and apart.rms > NEAR:
        ours, theirs = evidence.to_fixes or (0.0, 0.0)
        if theirs * CLEARLY < ours:
            words = f"the receiver agrees with the autopilot's ({theirs:.1f} m, not {ours:.1f} m)"
            (poor if apart.rms > FAR else fair).append(words)
        elif ours * CLEARLY >= theirs and apart.rms > FAR:
            fair.append("the receiver does not say which of the two is right")
    return Reasons(tuple(poor), tuple(fair))


def _of_status(report: Report, spent: float, evidence: Evidence) -> Reasons:
    """Judge the time in which the estimate doubted itself, or was none."""
    poor: list[str] = []
    fair: list[str] = []
    for status, words in (
        (Status.INVALID, "not valid for {:.0f} s"),
        (Status.DEAD_RECKONING, "without GNSS for {:.0f} s"),
        (Status.DEGRADED, "degraded for {:.0f} s"),
    ):
        seconds = report.seconds.get(status, 0.0)
        is_long = seconds > OFTEN * spent
        if status is Status.INVALID:
            is_long |= not evidence.is_right
        elif evidence.is_right or (status is Status.DEGRADED and evidence.is_shared):
            is_long = False
        if seconds > 1.0 and seconds > RARELY * spent * (status is Status.DEGRADED):
            by_reason = report.reasons.get(status, {})
            most = dict(sorted(by_reason.items(), key=lambda one: -one[1])[:MOST_REASONS])
            why = f" ({to_words(most)})" if status is Status.DEGRADED and most else ""
            (poor if is_long else fair).append(words.format(seconds) + why)
    return Reasons(tuple(poor), tuple(fair))


def _of_resets(report: Report) -> Reasons:
    fair: list[str] = []
    if report.reboots:
        times = "once" if report.reboots == 1 else f"{report.reboots} times"
        fair.append(f"the autopilot rebooted {times}")
    if report.resets <= 0:
        return Reasons(fair=tuple(fair))
    words = f"{counted(report.resets, 'reset')} (last: {report.reset_reason})"
    if report.resets > MOST_RESETS:
        return Reasons(poor=(words,), fair=tuple(fair))
    return Reasons(fair=(words, *fair))


def _of_fixes(report: Report) -> Reasons:
    """Judge the share of the fixes that was refused."""
    if report.health is None:
        return Reasons()
    share = report.health.refused_share(Aid.POSITION)
    words = (f"{share:.0%} of the fixes refused",)
    return Reasons(poor=words) if share > OFTEN else Reasons(fair=words if share > RARELY else ())


def _of_aids(report: Report) -> Reasons:
    """Name what other sensors were refused often: a disturbed compass, say; refusing is right."""
    if (health := report.health) is None:
        return Reasons()
    by_sensor = {words: health.verdicts[aid] for aid, words in AIDS.items()}
    by_sensor |= {
        words: health.headings[sensor]
        for sensor, words in SENSORS.items()
        if sensor in health.headings
    }
    return Reasons(aside=tuple(filter(None, map(_refusal, by_sensor, by_sensor.values()))))


def _refusal(sensor: str, verdicts: Mapping[Verdict, int]) -> str:
    """Return how many of a sensor's measurements were refused; empty: few."""
    refused, fused = refused_of(verdicts), fused_of(verdicts)
    if refused < FEWEST or refused <= OFTEN * (refused + fused):
        return ""
    share = f"{refused / (refused + fused):.0%}" if fused else f"all {refused}"
    words = f"{share} of the {sensor} refused"
    if verdicts[Verdict.DISTURBED] > MOSTLY * refused:
        words += " (its field is not the Earth's: calibrate mag may help)"
    return words


def _of_table(report: Report) -> Reasons:
    """Judge whether what a table's columns declare can be meant."""
    return Reasons(poor=("the units or axes look wrong",) if report.is_contradictory else ())


def _of_stamps(report: Report) -> Reasons:
    """Judge whether the inertial samples have stamps of their own, in order."""
    words = (report.stamps.words,) if report.stamps.words else ()
    return Reasons(poor=words) if report.stamps.is_most else Reasons(fair=words)


def _of_left_out(report: Report) -> Reasons:
    """Name what was left out in many places, for it is no measurement; leaving it out is right."""
    return Reasons(aside=tuple(one.words for one in report.left_out if one.words))


def _of_gap(report: Report) -> Reasons:
    """Judge the longest time without inertial samples, and their begin and end in the log."""
    seconds, begin_s = report.track.gap()
    ends = tuple(report.extent.lacks())
    words = (f"no inertial samples for {seconds:.{int(seconds < 10.0)}f} s at {begin_s:.0f} s",)
    if seconds > LONG_GAP:
        return Reasons(fair=words + ends)
    return Reasons(fair=ends, aside=words if seconds > SHORT_GAP else ())


def _of_samples(rate: float) -> Reasons:
    words = f"inertial samples at {rate:.3g} Hz"
    if rate < SLOW:
        words += f" ({SLOW:.0f} Hz or more would do)"
    return Reasons(fair=(words,) if rate < FAST_ENOUGH else ())


def _of_file(report: Report) -> Reasons:
    """Judge what of the file is damaged, and what of the telemetry never reached it."""
    fair: list[str] = []
    aside: list[str] = []
    if words := report.damage.words:
        (fair if report.damage.share > LARGEST_DAMAGE else aside).append(words)
    if report.lost_share > LARGEST_LOSS:
        fair.append(f"{report.lost_share:.0%} of the telemetry lost on the link")
    return Reasons((), tuple(fair), tuple(aside))


def _why_no_position(report: Report) -> str:
    if report.counts[Kind.GNSS] + report.derived == 0:
        return "no GNSS fix"
    return "no position, for no heading was found"

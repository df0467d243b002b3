"""Find whether scans and gyro agree, and with which stamps and axes they would.

The one theory behind it: a pair of scans, each point turned by the gyro from its own time, lies on
the same surfaces, up to a shift. Each hypothesis (stamps of the end, times backwards, axes
exchanged, degrees for radians) turns the points in its own way, and is judged by the distance that
is left. Pairs are chosen where the gyro turns and where its rate changes: elsewhere a hypothesis
changes nothing, and none is believed. What is believed is better in so many pairs alike that
chance is excluded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from ekf_companion.errors import LogError, part_of
from ekf_companion.lidar.readers.scans import Scans
from ekf_companion.lidar.readers.timing import Timing
from ekf_companion.lidar.recording import InertialSamples, Mounting, Scan
from ekf_companion.nav.arrays import Array, Indices

PAIRS = 16
POINTS = 250
"""Points of the first scan of a pair that are compared."""
MODEL = 2500
"""Points of the second that make the surfaces."""
NEIGHBOURS = 5
FIRST = 4
"""Pairs that reject a hypothesis that is worse in them, roughly compared."""
BELIEVED = 5.2
"""Student's t of the mean log ratio over the pairs: one in 20 000 by chance with 15 degrees of
freedom, for each of some 60 hypotheses."""
WITHIN_NOISE = 0.454 * 0.02
"""Distance that the noise of ranges alone leaves, m: the 35 % quantile of 20 mm. Rings on bare
ground turn with the lidar, and lie nearer to each other unturned than noise lets them."""
LIKELY = 2.0
"""The same for one hypothesis alone, one in 30."""


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """One way in which the recording may be meant."""

    shift: float = 0.0
    """s, added to the stamps of scans."""
    reverse: bool = False
    """The points' times count backwards."""
    axes: tuple[tuple[int, int], ...] = ((0, 1), (1, 1), (2, 1))
    """For each axis of the body the axis of the gyro and its sign."""
    scale: float = 1.0
    """Of the gyro."""

    def gyro(self, gyro: Array) -> Array:
        """Return the rates that the hypothesis claims."""
        return np.stack([gyro[..., axis] * sign for axis, sign in self.axes], -1) * self.scale

    def axes_in_words(self) -> str:
        """Return the axes as a user would write them."""
        return "(" + ", ".join("-"[sign > 0 :] + "xyz"[axis] for axis, sign in self.axes) + ")"


def compare_motion(
    scans: Scans, stamps: Array, inertial: InertialSamples, mounting: Mounting, may_shift: bool
) -> tuple[Timing, list[str]]:
    """Return the timing by which scans and gyro agree, and sentences about it.

    Args:
        scans: The scans, with the timing that their values show.
        stamps: s, of the scans in their order.
        inertial: The samples, in SI units and in order.
        mounting: The lidar on the inertial sensor.
        may_shift: Whether the stamps may turn out to be of another part of the scan.

    Raises:
        LogError: They contradict each other: axes, unit of the gyro, or another recording.
        MissingPackageError: SciPy is not installed.
    """
    timing = scans.timing
    pairs = _Pairs.of(scans, stamps, inertial, mounting)
    if pairs is None:
        return timing, ["the motion does not show whether scans and gyro agree"]
    plain = Hypothesis()
    base = pairs.misfit(plain)
    still = pairs.misfit(Hypothesis(scale=0.0))
    roughly = pairs.misfit(plain, rough=True).mean()
    # What changes nothing but times is tried first: it may be mended
    tried = dict[str, list[Hypothesis]]()
    if may_shift:
        # Of points without times the middle is the best stamp anyway, and half scans mean nothing
        half = () if timing.origin == "none" else (-0.5, 0.5)
        steps = (*range(-10, 0), *half, *range(1, 11))
        tried["shift"] = [Hypothesis(shift=step * timing.period) for step in steps]
    tried["reverse"] = [Hypothesis(reverse=True)]
    tried["scale"] = [Hypothesis(scale=np.pi / 180), Hypothesis(scale=180 / np.pi)]
    tried["axes"] = [Hypothesis(axes=axes) for axes in every_axes()[1:]]
    best, kind, misfit = plain, "", base
    for name, hypotheses in tried.items():
        for hypothesis in hypotheses:
            if name == "reverse" and timing.origin == "none":
                continue
            # Most are worse in the first few pairs already
            if pairs.misfit(hypothesis, rough=True).mean() > roughly:
                continue
            value = pairs.misfit(hypothesis)
            # A scale that is nearly 0 is no gyro: it must be far better than none
            helps = BELIEVED if name == "scale" else LIKELY
            better = _is_better(value, base) and _is_better(value, still, helps)
            if better and value.mean() < misfit.mean():
                best, kind, misfit = hypothesis, name, value
    times = float(np.exp((base - misfit).mean()))
    match kind:
        case "":
            return timing, _agreement(base, still, pairs)
        case "shift":
            return _shift(timing, pairs, best, times)
        case "reverse":
            return replace(timing, reverse=True), [
                f"times of points count backwards: the scans agree {times:.1f} times better so"
            ]
        case "scale":
            unit = "deg/s" if best.scale < 1 else "rad/s where deg/s was meant"
            raise LogError(
                f"{scans.source.name}: the gyro is in {unit}: the scans turn "
                f"{best.scale:.3g} times as fast as it says; it must be in rad/s"
            )
        case _:
            raise LogError(
                f"{scans.source.name}: the axes of gyro and lidar do not belong together: the "
                f"scans agree {times:.1f} times better if the gyro's (x, y, z) are read as "
                f"{best.axes_in_words()}; correct the axes of the inertial samples (forward, left, "
                "up), or give the lidar's mounting"
            )


def _agreement(base: Array, still: Array, pairs: _Pairs) -> list[str]:
    """Return what to say where nothing is better than what the values show.

    Raises:
        LogError: Not even the gyro is better than none.
    """
    if _is_better(base, still):
        return [
            f"scans and gyro agree: {np.exp(base.mean()) * 1e3:.0f} mm between scans turned by it, "
            f"{np.exp(still.mean()) * 1e3:.0f} mm without it"
        ]
    # Where scans can be laid on each other by a free turn, the gyro must have told it
    free = pairs.misfit(Hypothesis(), free=True)
    helps = _is_better(base, still, LIKELY)
    is_apart = np.exp(base.mean()) > WITHIN_NOISE
    if is_apart and not helps and _is_better(free, base) and (base - free).mean() > np.log(2.0):
        raise LogError(
            f"{pairs.name}: the scans do not turn as the gyro says, and no exchange of axes, unit "
            "or stamp makes them agree: the inertial samples are of another sensor or another time"
        )
    return ["the motion does not show whether scans and gyro agree"]


def _shift(
    timing: Timing, pairs: _Pairs, best: Hypothesis, times: float
) -> tuple[Timing, list[str]]:
    """Return the timing with its stamps put right, to a tenth of a scan."""
    steps = np.arange(-5, 6) * 0.1 * timing.period
    around = [Hypothesis(shift=best.shift + step) for step in steps]
    finest = min(around, key=lambda one: float(pairs.misfit(one).mean())).shift
    if timing.origin == "none":
        finest = best.shift
    share = finest / timing.period
    for place, name in ((-1.0, "end"), (-0.5, "middle")):
        if abs(share - place) < 0.25:
            return replace(timing, shift=timing.shift + place * timing.period), [
                f"stamps are of the {name} of a scan: the scans agree {times:.1f} times better so"
            ]
    late = "late" if finest < 0 else "early"
    return replace(timing, shift=timing.shift + finest), [
        f"stamps of scans are {abs(finest):.2f} s {late} by the gyro: corrected, as the scans "
        f"agree {times:.1f} times better so; use one clock for both"
    ]


def _is_better(one: Array, other: Array, least: float = BELIEVED) -> bool:
    """Return whether log distances are less by more than chance: Student's t above `least`."""
    gain = other - one
    error = gain.std(ddof=1) / np.sqrt(len(gain))
    return bool(gain.mean() > least * error and gain.mean() > 0)


def every_axes() -> list[tuple[tuple[int, int], ...]]:
    """Return every exchange of axes and signs, mirrored ones too; the plain one is the first."""
    return [
        tuple(zip(axes, signs, strict=True))
        for axes in permutations(range(3))
        for signs in product((1, -1), repeat=3)
    ]


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Neighbouring scans, with the inertial samples around them."""

    name: str
    period: float
    """s, from scan to scan."""
    scans: tuple[tuple[Scan, Scan], ...]
    stamp: Array
    """s, after each pair's first stamp, shape (pairs, n)."""
    gyro: Array
    """rad/s, shape (pairs, n, 3)."""
    rotation: Array
    """Lidar to body."""
    position: Array
    """m."""

    @classmethod
    def of(
        cls, scans: Scans, stamps: Array, inertial: InertialSamples, mounting: Mounting
    ) -> _Pairs | None:
        """Return the pairs that show most, or None if too few are there."""
        chosen = _choose(stamps, inertial)
        if len(chosen) < PAIRS // 2:
            return None
        both = np.unique(np.concatenate((chosen, chosen + 1)))
        wanted = scans.order[both]
        read = {int(both[place]): scan for place, scan in scans.numbered(wanted)}
        rng = np.random.default_rng(0)
        chosen = rng.permutation(chosen)  # so that the first few are of all parts
        pairs, rows = [], []
        step = float(np.median(np.diff(inertial.stamp)))
        reach = 13 * scans.timing.period
        count = int(2 * reach / step)
        for k in chosen:
            one, two = read.get(int(k)), read.get(int(k) + 1)
            if one is None or two is None or min(len(one.points), len(two.points)) < 50:
                continue
            pairs.append((_thin(one, POINTS, rng), _thin(two, MODEL, rng)))
            begin = int(np.searchsorted(inertial.stamp, one.stamp - reach))
            rows.append(np.clip(np.arange(begin, begin + count), 0, len(inertial.stamp) - 1))
        if len(pairs) < PAIRS // 2:
            return None
        which = np.array(rows)
        first = np.array([one.stamp for one, _ in pairs])
        return cls(
            scans.source.name,
            scans.timing.period,
            tuple(pairs),
            inertial.stamp[which] - first[:, None],
            inertial.gyro[which],
            mounting.rotation,
            mounting.position,
        )

    def misfit(self, hypothesis: Hypothesis, *, rough: bool = False, free: bool = False) -> Array:
        """Return the log of the distance of each pair, m, under a hypothesis."""
        first = FIRST if rough else PAIRS
        scans = self.scans[:first]
        # Of the samples only those around the scans: integrating them takes the time
        reach = abs(hypothesis.shift) + 2.5 * self.period
        middle = np.abs(self.stamp[:first] - 0.5 * self.period).min(axis=0) < reach
        stamp, gyro = self.stamp[:first, middle], self.gyro[:first, middle]
        attitude = attitudes(stamp, hypothesis.gyro(gyro))
        result = []
        for pair, (one, two) in enumerate(scans):
            placed = []
            for scan in (one, two):
                times = scan.times
                if hypothesis.reverse and len(times):
                    times = times.max() + times.min() - times
                at = scan.stamp - one.stamp + hypothesis.shift + times
                body = scan.points @ self.rotation.T + self.position
                placed.append(_turn(stamp[pair], attitude[pair], at, body))
            result.append(
                np.log(
                    _distance(placed[0][:: 2 if rough else 1], placed[1], 2 if rough else 4, free)
                )
            )
        return np.array(result)


def _choose(stamps: Array, inertial: InertialSamples) -> Indices:
    """Return the first scans of the pairs that turn most, and of those whose rate changes most."""
    rate = np.stack(
        [np.interp(stamps, inertial.stamp, inertial.gyro[:, axis]) for axis in range(3)], -1
    )
    size = np.linalg.norm(rate, axis=1)
    change = np.zeros(len(stamps))
    change[1:-1] = np.linalg.norm(rate[2:] - rate[:-2], axis=1)
    inside = (stamps > inertial.stamp[0] + 1.5) & (stamps < inertial.stamp[-1] - 1.5)
    inside[-1] = False
    free = inside.copy()
    chosen = list[int]()
    for measure in (size, change):
        for _ in range(PAIRS // 2):
            if not free.any():
                break
            k = int(np.argmax(np.where(free, measure, -1.0)))
            chosen.append(k)
            free[max(k - 2, 0) : k + 3] = False  # neighbours would say the same again
    return np.array(sorted(chosen), np.int64)


def _thin(scan: Scan, most: int, rng: np.random.Generator) -> Scan:
    if len(scan.points) <= most:
        return scan
    keep = rng.choice(len(scan.points), most, replace=False)
    return Scan(scan.stamp, scan.points[keep], scan.times[keep])


def attitudes(stamp: Array, gyro: Array) -> Array:
    """Return quaternions (w, x, y, z) of the body at each stamp, from the first one on."""
    half = 0.25 * (gyro[:, 1:] + gyro[:, :-1]) * np.diff(stamp)[..., None]
    angle = np.linalg.norm(half, axis=-1, keepdims=True)
    step = np.concatenate((np.cos(angle), np.sinc(angle / np.pi) * half), -1)
    result = np.empty((*stamp.shape, 4))
    q = np.zeros((len(stamp), 4))
    q[:, 0] = 1.0
    result[:, 0] = q
    for k in range(step.shape[1]):
        w, v = step[:, k, :1], step[:, k, 1:]
        q = np.concatenate(
            (
                q[:, :1] * w - (q[:, 1:] * v).sum(-1, keepdims=True),
                q[:, :1] * v + w * q[:, 1:] + _cross(q[:, 1:], v),
            ),
            -1,
        )
        result[:, k + 1] = q
    return result


def _cross(one: Array, two: Array) -> Array:
    """Return the cross products of rows; NumPy's takes ten times as long for a few."""
    (a, b, c), (d, e, f) = one.T, two.T
    return np.stack((b * f - c * e, c * d - a * f, a * e - b * d), -1)


def _turn(stamp: Array, attitude: Array, at: Array, points: Array) -> Array:
    """Return points, each turned by the attitude at its time."""
    q = np.stack([np.interp(at, stamp, attitude[:, part]) for part in range(4)], -1)
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    twice = 2.0 * _cross(q[:, 1:], points)
    return points + q[:, :1] * twice + _cross(q[:, 1:], twice)


def _distance(points: Array, model: Array, steps: int, free: bool) -> float:
    """Return how near points are to the surfaces of a model, after the best shift, and turn.

    Of their distances the 35 % quantile: in a sparse scan half the points have no surface near.

    Args:
        points: m, shape (n, 3).
        model: m, shape (m, 3).
        steps: Times that the shift is improved.
        free: Whether the points may be turned too.
    """
    steps = 10 if free else steps
    with part_of("lidar", "reading a recording of a lidar"):
        from scipy.spatial import cKDTree
    tree = cKDTree(model)
    moved, parts = points, 6 if free else 3
    for step in range(steps):
        near = model[tree.query(moved, NEIGHBOURS)[1]]
        centre = near.mean(axis=1)
        spread = near - centre[:, None]
        normal = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))[1][:, :, 0]
        distance = np.abs(signed := ((moved - centre) * normal).sum(axis=1))
        if step == steps - 1:
            break
        # Far ones count little; a metre or a radian of doubt keeps what nothing holds where it is
        scale = max(2.0 * float(np.median(distance)), 1e-3)
        rows = np.concatenate((normal, _cross(moved, normal)), 1)[:, :parts]
        weighted = rows / (1.0 + (distance / scale) ** 2)[:, None]
        change = np.linalg.solve(weighted.T @ rows + np.eye(parts) * scale**2, -weighted.T @ signed)
        turn = np.array([0.0, 0.0, 0.0]) if not free else change[3:]
        moved = moved + change[:3] + np.cross(turn, moved)
    return max(float(np.quantile(distance, 0.35)), 1e-6)

"""Fault hypotheses: what may have begun to be wrong, weighed by what every reading says.

An instance is one kind of fault that began at one time: a constant b, normal with the prior of its
kind. If it is the right one, an innovation is ``r = T b + noise`` with ``T = H U + D``, of
covariance ``S + T M T'``; so each reading adds to its evidence beside that of no fault, and says
more of b. An onset is tried at each reading, and kept in an exponential histogram: three instances
of a kind for each power of two of onsets, the two oldest of a full level become one of the next.

Each has its own gate: 80 m are an outlier where nothing is wrong, and none where a step began. An
outlier costs a reading no more than that it may be one of 200, a hundred times wider.

Source: Willsky and Jones 1976 (generalized likelihood ratio); Joerger and Pervan 2013 (posterior).
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter import columns
from cython.cimports.ekf_companion.core.filter.observation import row_variance
from cython.cimports.ekf_companion.core.filter.slow_error import carried
from cython.cimports.ekf_companion.core.memory.bank import COMPONENTS, Bank, Instance
from cython.cimports.ekf_companion.core.memory.constants import EVEN, FADES, NEVER, THREE_SIGMA2
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_HEADING,
    AID_REST,
    AID_VELOCITY,
    AIDS,
    AZIMUTH_MAGNETIC,
    E_POS,
    E_VEL,
    FAULT_ACCEL_NOISE,
    FAULT_ALIGNMENT,
    FAULT_GYRO_NOISE,
    FAULT_RECOVERY,
    FAULT_STATE_WILD,
    FAULT_VELOCITY_SCALE,
    MODE_NAVIGATE,
    SHOWS_ALL,
    SHOWS_LEVEL,
    SHOWS_VERTICAL,
    SOURCE_DRAG,
    SOURCE_FALL,
    SOURCES,
    N,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.trust import delay_search, lost, onsets, score, shape
from cython.cimports.libc.math import exp, fabs, log, sqrt

GATE = cython.declare(cython.double, 9.0)
"""NIS a row beyond which a reading teaches an instance less, as if its noise had been larger."""
OUTLIER = cython.declare(cython.double, 10.6)
"""2 ln 200: one reading of 200 is an outlier."""
OUTLIER_ROW = cython.declare(cython.double, 9.4)
"""2 ln 110, a row: its errors are so many times wider."""
WANDERS = cython.declare(cython.double, 10.0)
"""Time for which the errors of a position that is wrong in no shape are much the same, s: of 144
flights of wandering receivers 76 s are OK and wrong, with 3 s here as well 249."""
SWINGS = cython.declare(cython.double, 3.0)
"""The same of a velocity, s; with 10 s it is 139."""
BLOCK = cython.declare(cython.double, 2e9)
"""Time over which innovations of an aid are summed to see what they have in common, ns."""
MEMORY = cython.declare(cython.double, 10.0)
"""Blocks that this is learnt over."""
RECENT = cython.declare(cython.double, 10.0)
"""Readings over which the mean NIS of an instance is taken: five fixes of two rows or more."""
OPEN = cython.declare(cython.double, 0.25)
"""Least variance of the size, of its prior, down to which it is open: half the sigma."""
LN_TEN = cython.declare(cython.double, 2.302585092994046)
"""What it costs to be one of ten."""
AGAIN = cython.declare(cython.double, 100.0)
"""How much more often a source fails that has just failed, a receiver among houses."""
ANY = cython.declare(cython.double, 1e8)
"""Variance of a row that says nothing, of the square of its unit."""
LEAST = cython.declare(cython.double, 1e-300)
"""Least odds of nothing beside the most probable fault."""
SPACING = cython.declare(cython.double, 0.095e9)
"""Least time between two readings of one aid that are weighed, ns: a compass at 50 Hz says little
more than at 10; with 5 a barometer's step was missed in a report. They correct the state, and so
the columns, all the same."""


def begin(x: State, k: Parameters, b: Bank) -> None:
    """Begin with no instance."""
    b.n = 0
    b.pairs = 0
    b.triples = 0
    b.fours = 0
    b.kept = -1
    b.rival = -1
    b.is_observed = 0
    b.fix_t = NEVER
    b.proven_t = NEVER
    b.nothing = 1.0
    b.astray = 0.0
    for source in range(SOURCES):
        b.since[source] = NEVER
    for aid in range(AIDS):
        b.begun_t[aid] = NEVER
        b.weighed_t[aid] = NEVER
        if not b.common[aid] >= 1.0:
            b.common[aid] = 1.0
    score.begin(x, b)
    lost.begin(k, b)
    delay_search.forget(b)
    columns.stand(b)


def judge(x: State, k: Parameters, o: Observation, aid: int) -> None:
    """Weigh an observation as :func:`~.update.innovate` left it, before it corrects anything."""
    b = address(o.bank[0])
    if x.resets + 1.0 != b.resets or x.mode != MODE_NAVIGATE or x.needs_reset != 0.0:
        begin(x, k, b)
        b.resets = x.resets + 1.0
    if x.mode != MODE_NAVIGATE or x.needs_reset != 0.0 or x.has_yaw == 0.0:
        return
    columns.follow(x, b)
    # an aid that no hypothesis is about would blame others for what is wrong with itself
    is_weighed = cython.declare(
        cython.bint,
        aid <= AID_VELOCITY or (aid <= AID_REST and x.t - b.weighed_t[aid] >= SPACING),
    )
    if aid == AID_VELOCITY:
        delay_search.compare(x, b, o)
    if is_weighed:
        onsets.begin_instances(x, k, b, o, aid)
        b.weighed_t[aid] = x.t
    for r in range(o.rows):
        b.group[r] = 1.0 if is_vertical(o, r) else 0.0
    columns.observe(b, o, carried(x))
    b.is_observed = 1
    b.judged = aid
    b.read_dt = (x.t - b.read_t[aid]) * 1e-9
    b.read_t[aid] = x.t
    for i in range(b.n):
        h = address(b.instance[i])
        if shape.is_wild(h.kind):
            undo(k, b, i, o, aid)
            continue
        shape.find_direct(x, b, h, o, aid)
        for c in range(h.rows if h.rows < 3 else 3):
            for r in range(o.rows):
                b.T[c][r][i] += b.trial.D[r][c]
    if not is_weighed:
        return
    for g in range(2):
        b.rows[g] = 0.0
        b.work[g] = 0.0
    for r in range(o.rows):
        g = 1 if b.group[r] != 0.0 else 0
        b.rows[g] += 1.0
        b.work[g] += o.y[r] * o.y[r]
    find_wrong(x, k, b, aid)
    share = 1.0 / learn_common(x, b, o, aid, b.work[0] + b.work[1])
    known = 0.0
    if aid == AID_HEADING and x.azimuth >= AZIMUTH_MAGNETIC:
        known = x.field_noise.looks
    b.work[0] = cost(b.work[0], b.rows[0], known)
    b.work[1] = cost(b.work[1], b.rows[1], known)
    for i in range(b.n):
        weigh_reading(x, k, b, i, o, aid, b.work, share, known)
    weigh_lost(x, k, b, o, aid, share, known)
    if aid < AID_VELOCITY:
        follow_led(k, b, o, aid)
    lost.keep(b, o, aid)
    renew(k, b, aid)
    onsets.thin(x, k, b)
    find_posterior(x, k, b)
    learn_erratic(x, k, b, o, aid)
    if aid == AID_HEADING and x.azimuth >= AZIMUTH_MAGNETIC:
        shape.keep_field_slope(b, o)


def undo(k: Parameters, b: Bank, i: int, o: Observation, aid: int) -> None:
    """Let what is wrong in no shape take back all that its source's rows correct.

    Under it the state is x + U, and not corrected at all: what x is corrected by is the innovation.
    """
    g = shape.rows_of(aid, k.fault[b.instance[i].kind].source)
    for r in range(o.rows):
        if g >= 0 and g == (1 if b.group[r] != 0.0 else 0):
            b.T[0][r][i] = o.z[r]


def let_stay(k: Parameters, b: Bank, i: int, o: Observation, aid: int) -> None:
    """Let it stay what they correct, as wide as they are then: T by the state alone."""
    g = shape.rows_of(aid, k.fault[b.instance[i].kind].source)
    for r in range(o.rows):
        if g >= 0 and g == (1 if b.group[r] != 0.0 else 0):
            b.T[0][r][i] = 0.0
            for e in range(N):
                b.T[0][r][i] += o.H[r][e] * b.U[0][e][i]


def follow_led(k: Parameters, b: Bank, o: Observation, aid: int) -> None:
    """Follow how far a position goes away that adds up what is wrong in its velocity."""
    for r in range(o.rows):
        var = usual_var(k, b, AID_VELOCITY, 1 if b.group[r] != 0.0 else 0)
        b.led_var[aid][r] += var * b.read_dt * b.read_dt
        gain = b.led_var[aid][r] / (b.led_var[aid][r] + row_variance(o, r))
        b.led[aid][r] += gain * (o.z[r] - b.led[aid][r])
        b.led_var[aid][r] *= 1.0 - gain


def erratic_var(k: Parameters, b: Bank, h: Instance, aid: int, group: int, since: float) -> float:
    """Return the mean square of the errors of an aid's rows that are wrong in no shape.

    A position whose velocity is so, too, is off by what that adds up to in the time, s.
    """
    var = usual_var(k, b, aid, group)
    if not is_led_away(k, h, aid):
        return var
    grown = usual_var(k, b, AID_VELOCITY, group) * since * since
    return grown if grown < var else var


def is_led_away(k: Parameters, h: Instance, aid: int) -> bool:
    """Return whether a fault leads away what an aid observes together with the velocity."""
    source = k.fault[h.kind].source
    return aid != AID_VELOCITY and (source == SOURCE_DRAG or source == SOURCE_FALL)


def alike(b: Bank, aid: int) -> float:
    """Return how many readings of an aid in a row say much the same while it is erratic."""
    many = (SWINGS if aid == AID_VELOCITY else WANDERS) / b.read_dt
    return many if many > 1.0 else 1.0


def usual_var(k: Parameters, b: Bank, aid: int, group: int) -> float:
    """Return the mean square of the errors of an aid that has been erratic for long."""
    std = k.fault[shape.offset_of(aid, group)].std
    learnt = b.erratic_var[aid][group]
    return learnt if learnt > std * std else std * std


def learn_erratic(x: State, k: Parameters, b: Bank, o: Observation, aid: int) -> None:
    """Learn from a reading how large the errors of a source are that is wrong in no shape."""
    find_wrong(x, k, b, aid)
    for r in range(o.rows):
        g = 1 if b.group[r] != 0.0 else 0
        if b.erratic[g] > EVEN:
            var = usual_var(k, b, aid, g)
            own = row_variance(o, r)
            seen = o.z[r] * o.z[r] - own
            weight = var / (var + own)
            var += weight * weight * (seen - var) / (RECENT * b.rows[g])
            b.erratic_var[aid][g] = var


def cost(nis: float, rows: float, known: float) -> float:
    """Return what a NIS costs, in its own unit, where the reading may be an outlier instead.

    A noise that is known from some readings only may be larger: then it is that of Student's t.
    """
    if known > 0.0:
        nis = (known + rows) * log(1.0 + nis / known)
    most = OUTLIER + OUTLIER_ROW * rows
    return nis if nis < most else most


def weigh_reading(
    x: State,
    k: Parameters,
    b: Bank,
    i: int,
    o: Observation,
    aid: int,
    nothing: Vector,
    share: float,
    known: float,
) -> None:
    """Add what a reading says to the evidence of an instance, and learn its b from it.

    A level and a vertical fault may be there at once: what both explain counts for one of them, by
    the rows that are its own.
    """
    h = address(b.instance[i])
    if shape.is_wild(h.kind):
        weigh_erratic(x, k, b, h, o, aid, nothing, share)
        return
    to = address(b.trial)
    rows = h.rows
    shown = 0.0
    own = 0.0
    shows = k.fault[h.kind].shows
    for r in range(o.rows):
        is_own = cython.declare(
            cython.bint, shows == SHOWS_ALL or (b.group[r] != 0.0) == (shows == SHOWS_VERTICAL)
        )
        own += 1.0 if is_own else 0.0
        for c in range(rows):
            s = b.T[c][r][i]
            for j in range(r):
                s -= o.L[r][j] * to.T[j][c]
            to.T[r][c] = s / o.L[r][r]
            shown += to.T[r][c] * to.T[r][c] if is_own else 0.0
    if shown == 0.0:
        return
    if h.kind >= FAULT_ACCEL_NOISE:
        if aid != AID_HEADING:
            score.add_to_window(b, 3 if h.kind == FAULT_GYRO_NOISE else 0, o)
        return
    nis = try_reading(b, h, o, shows, 1.0)
    if nis > GATE * own and h.is_wide == 0.0 and is_open(k, h):
        widen(k, h)
        nis = try_reading(b, h, o, shows, 1.0)
    h.readings += 1.0
    h.recent += (nis / own - h.recent) / (h.readings if h.readings < RECENT else RECENT)
    gain = -log(to.spread)
    for g in range(2):
        if b.rows[g] > 0.0 and (shows == SHOWS_ALL or g == (1 if shows == SHOWS_VERTICAL else 0)):
            gain += nothing[g] - cost(to.nis[g], b.rows[g], known)
    h.evidence += 0.5 * share * gain
    if nis > GATE * own:
        try_reading(b, h, o, shows, nis / (GATE * own))
    for c in range(rows):
        h.b[c] = to.b[c]
        for j in range(rows):
            h.M[c][j] = to.M[c][j]


def weigh_erratic(
    x: State,
    k: Parameters,
    b: Bank,
    h: Instance,
    o: Observation,
    aid: int,
    nothing: Vector,
    share: float,
) -> None:
    """Add what a reading says to the evidence that its source is wrong in no shape.

    Where the state is hardly known a reading that fits says little against it: it would then, too;
    nor does a position whose velocity is wrong: it goes on from where it was. Beside noisy inertial
    samples outliers alone speak for it.
    """
    g = shape.rows_of(aid, k.fault[h.kind].source)
    if g < 0 or b.rows[g] == 0.0:
        return
    wide = 0.0
    for r in range(o.rows):
        if g == (1 if b.group[r] != 0.0 else 0):
            own = row_variance(o, r)
            var = own + usual_var(k, b, aid, g)
            off = o.z[r]
            if is_led_away(k, h, aid):
                var = own + b.led_var[aid][r]
                off -= b.led[aid][r]
            wide += off * off / var + log(var / own)
    most = OUTLIER_ROW * b.rows[g]
    if wide > most or (score.is_noisy(x) and h.is_wide == 0.0):
        wide = most
    gain = 0.5 * (nothing[g] - wide)
    if gain < 0.0 and h.is_wide != 0.0 and share * alike(b, aid) > 1.0:
        share = 1.0 / alike(b, aid)
    h.evidence += share * gain


def weigh_lost(
    x: State, k: Parameters, b: Bank, o: Observation, aid: int, share: float, known: float
) -> None:
    """Add what a reading says to the evidence that our own state is wrong in no shape.

    Whenever that began. Nothing, where the inertial samples are noisier than configured: any state
    is off by that.
    """
    if score.is_noisy(x):
        return
    for g in range(2):
        if b.rows[g] > 0.0:
            wide = cost(lost.find_nis(x, k, b, o, aid, g), b.rows[g], known)
            gain = 0.5 * share * (b.work[g] - wide)
            for i in range(b.n):
                if b.instance[i].kind == FAULT_STATE_WILD:
                    b.instance[i].evidence += gain


def renew(k: Parameters, b: Bank, aid: int) -> None:
    """Let what was declared to be wrong in no shape be right again at any reading, once a minute.

    The state owes nothing to its readings. So that nothing is wrong is that nothing is from now on;
    it takes over what is beyond the odds of that, and all others are beside it.
    """
    most = -log(k.fault[FAULT_RECOVERY].rate * b.read_dt / 3600.0)
    for i in range(b.n):
        h = address(b.instance[i])
        beyond = h.evidence + h.log_prior - most
        if beyond > 0.0 and h.is_wide != 0.0 and shape.is_wild(h.kind):
            if shape.rows_of(aid, k.fault[h.kind].source) >= 0:
                take_over(k, b, k.fault[h.kind].shows, beyond)


def take_over(k: Parameters, b: Bank, shows: int, beyond: float) -> None:
    """Let nothing be as much more probable than any fault of such rows."""
    for i in range(b.n):
        of = address(k.fault[b.instance[i].kind])
        if b.instance[i].kind < FAULT_ACCEL_NOISE and (of.shows == shows or of.shows == SHOWS_ALL):
            b.instance[i].evidence -= beyond


def is_vertical(o: Observation, r: int) -> bool:
    """Return whether a row observes height or vertical velocity, rather than what is level."""
    level = 0.0
    for i in range(2):
        level += fabs(o.H[r][E_POS + i]) + fabs(o.H[r][E_VEL + i])
    return fabs(o.H[r][E_POS + 2]) + fabs(o.H[r][E_VEL + 2]) > level


def is_open(k: Parameters, h: Instance) -> bool:
    """Return whether the size of a fault is hardly known yet: what was learnt stays learnt."""
    prior = k.fault[h.kind].std * k.fault[h.kind].std
    for c in range(h.rows):
        if h.M[c][c] < OPEN * prior:
            return False
    return True


def widen(k: Parameters, h: Instance) -> None:
    """Take an instance for one of the tenth that is far larger, at what that costs."""
    ratio = k.fault[h.kind].tail / k.fault[h.kind].std
    h.is_wide = 1.0
    if ratio <= 1.0:
        return
    h.evidence -= LN_TEN
    for c in range(COMPONENTS):
        for j in range(COMPONENTS):
            h.M[c][j] *= ratio * ratio


def try_reading(b: Bank, h: Instance, o: Observation, shows: int, noise: float) -> float:
    """Learn b from the own rows of a whitened reading of that variance; return their NIS."""
    to = address(b.trial)
    rows = h.rows
    to.spread = 1.0
    to.nis[0] = 0.0
    to.nis[1] = 0.0
    for c in range(rows):
        to.b[c] = h.b[c]
        for j in range(rows):
            to.M[c][j] = h.M[c][j]
    for r in range(o.rows):
        group = 1 if b.group[r] != 0.0 else 0
        if shows != SHOWS_ALL and group != (1 if shows == SHOWS_VERTICAL else 0):
            continue
        e = o.y[r]
        s = noise
        for c in range(rows):
            to.gain[c] = 0.0
            for j in range(rows):
                to.gain[c] += to.M[c][j] * to.T[r][j]
            e -= to.T[r][c] * to.b[c]
            s += to.T[r][c] * to.gain[c]
        to.nis[group] += e * e / s
        to.spread *= s
        for c in range(rows):
            to.b[c] += to.gain[c] * e / s
            for j in range(rows):
                to.M[c][j] -= to.gain[c] * to.gain[j] / s
    return to.nis[0] + to.nis[1]


def learn_common(x: State, b: Bank, o: Observation, aid: int, nis: float) -> float:
    """Learn how many readings of an aid in a row say the same; return it, at least one.

    The square of their sum over their number, over blocks of two seconds: one, if they are white.
    What is beyond the gate is no noise, and says nothing of it.
    """
    if b.count[aid] == 0.0 or x.t - b.block_t[aid] > BLOCK:
        if b.count[aid] > 1.0:
            seen = 0.0
            for r in range(o.rows):
                seen += b.sum[aid][r] * b.sum[aid][r] / (b.count[aid] * o.rows)
            b.common[aid] += (seen - b.common[aid]) / MEMORY
        b.count[aid] = 0.0
        b.block_t[aid] = x.t
        for r in range(3):
            b.sum[aid][r] = 0.0
    if nis <= GATE * o.rows:
        b.count[aid] += 1.0
        for r in range(o.rows):
            b.sum[aid][r] += o.y[r]
    return b.common[aid] if b.common[aid] > 1.0 else 1.0


def open_rows(x: State, k: Parameters, o: Observation, aid: int) -> bool:
    """Open the rows whose source is more likely wrong than right: they correct nothing.

    So what is wild in no shape at all, and explained by one fault after the other, leads nobody
    astray meanwhile. The columns follow what was really done.
    """
    b = address(o.bank[0])
    if x.t < b.hold_t:  # nothing is believed while the inertial noise leaps
        return False
    find_wrong(x, k, b, aid)
    if b.wrong[0] <= EVEN and b.wrong[1] <= EVEN:
        return False
    for r in range(o.rows):
        g = 1 if is_vertical(o, r) else 0
        if is_mostly_erratic(b, g):
            o.R[r][r] += b.square[g] / b.erratic[g] * alike(b, aid)
        elif b.wrong[g] > EVEN:
            o.R[r][r] += ANY
    for i in range(b.n):
        g = shape.rows_of(aid, k.fault[b.instance[i].kind].source)
        if g >= 0 and shape.is_wild(b.instance[i].kind) and is_mostly_erratic(b, g):
            let_stay(k, b, i, o, aid)
    return True


def is_mostly_erratic(b: Bank, group: int) -> bool:
    """Return whether the source of such rows is more likely wrong than right, and in no shape."""
    return b.wrong[group] > EVEN and b.erratic[group] > 0.5 * b.wrong[group]


def find_wrong(x: State, k: Parameters, b: Bank, aid: int) -> None:
    """Find how probable it is that the source of the level, and of the vertical rows is wrong.

    As far as another one could contradict it: none a position and a velocity that are led away as
    if the vehicle were.
    """
    for g in range(2):
        b.wrong[g] = 0.0
        b.erratic[g] = 0.0
        b.square[g] = 0.0
    for i in range(b.n):
        kind = b.instance[i].kind
        g = shape.rows_of(aid, k.fault[kind].source)
        if g >= 0 and (k.fault[kind].source != SOURCE_DRAG or shape.is_wild(kind)):
            b.wrong[g] += b.instance[i].p
            if shape.is_wild(kind):
                h = address(b.instance[i])
                b.erratic[g] += h.p
                b.square[g] += h.p * erratic_var(k, b, h, aid, g, (x.t - h.t0) * 1e-9)


def explains(b: Bank) -> bool:
    """Return whether a fault is more likely than not, and explains its own last readings."""
    for i in range(b.n):
        h = address(b.instance[i])
        if h.p > EVEN and h.recent < THREE_SIGMA2 and h.kind != FAULT_STATE_WILD:
            return True
    return False


def again(x: State, k: Parameters, b: Bank, h: Instance) -> float:
    """Return how much more often a source fails that has just failed: it fades in a minute.

    Not a state that is lost: it has been found anew.
    """
    failed_t = b.failed_t[k.fault[h.kind].source]
    if h.kind == FAULT_STATE_WILD:
        return 1.0
    if failed_t <= 0.0 or shape.is_end(h.kind) or (shape.is_wild(h.kind) and h.is_wide != 0.0):
        return 1.0
    return 1.0 + AGAIN * exp(1e-9 * (failed_t - h.t0) / FADES if h.t0 > failed_t else 0.0)


def off_circle(k: Parameters, h: Instance) -> float:
    """Return how much less likely a cosine and a sine are for not being those of one angle.

    Nor is a velocity that is too short, by what usual ones are, one that is turned.
    """
    c = 1.0 + h.b[0]
    s = h.b[1]
    square = c * c + s * s
    std = k.fault[FAULT_VELOCITY_SCALE].std
    var = h.M[0][0]
    if square > var:
        var = (c * c * h.M[0][0] + 2.0 * c * s * h.M[0][1] + s * s * h.M[1][1]) / square
    off = 1.0 - sqrt(square)
    return 0.5 * off * off / (var + std * std)


def find_posterior(x: State, k: Parameters, b: Bank) -> None:
    """Find how probable each instance is; what is level and what is vertical may fail apart."""
    most = 0.0
    whole = 0.0
    level = 0.0
    vertical = 0.0
    for i in range(b.n):
        h = address(b.instance[i])
        h.p = h.evidence + h.log_prior
        often = again(x, k, b, h)
        if often > 1.0:
            h.p += log(often)
        if h.kind == FAULT_ALIGNMENT:
            h.p -= off_circle(k, h)
        most = h.p if h.p > most else most
    # all by the largest, so that no exponential is too large
    for i in range(b.n):
        h = address(b.instance[i])
        h.p = exp(h.p - most)
        if k.fault[h.kind].shows == SHOWS_LEVEL:
            level += h.p
        elif k.fault[h.kind].shows == SHOWS_VERTICAL:
            vertical += h.p
        else:
            whole += h.p
    none = exp(-most)
    none = none if none > LEAST else LEAST
    # a pair of one level and one vertical fault is as probable as the product of their odds
    total = whole + (none + level) * (1.0 + vertical / none)
    b.nothing = none / total
    b.astray = 0.0
    for i in range(b.n):
        h = address(b.instance[i])
        h.p /= total
        if k.fault[h.kind].shows == SHOWS_LEVEL:
            h.p *= 1.0 + vertical / none
        elif k.fault[h.kind].shows == SHOWS_VERTICAL:
            h.p *= 1.0 + level / none
        if h.kind == FAULT_ALIGNMENT:
            b.astray = h.p

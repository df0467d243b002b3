"""Gates, counts and time-outs of the aids, and the consistency test of refused ones.

An innovation inside the soft gate counts in full. Between the soft and the hard gate it counts the
less the further out it is, as if its noise had been larger. Beyond the hard gate it is refused.

A receiver that goes on being refused has to prove itself. One that has truly found a new place
moves from fix to fix as we do: its innovations stay the same. One that is dragged off, or says
anything at all, moves otherwise. So a run of refused innovations is kept as the sums of a straight
line; a small slope and a small scatter prove it.

Source: least squares of a line, e.g. Bevington 2003, section 6.3.
"""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.filter.update import (
    apply_update,
    apply_yaw_update,
    inflate_noise,
    innovate,
)
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_HEADING,
    AIDS,
    AZIMUTH_MAGNETIC,
    NEEDS_FIX,
    VERDICT_DENIED,
    VERDICT_DEWEIGHTED,
    VERDICT_FUSED,
    VERDICT_GATED,
    WEIGH_ACT,
)
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.trust import hypotheses
from cython.cimports.libc.math import fabs, isnan, log, sqrt

LONGEST_RUN = cython.declare(cython.double, 40.0)
"""Duration after which a run that failed the test begins anew, s; beyond the longest patience."""
FEWEST = cython.declare(cython.double, 4.0)
"""Least number of innovations in a run."""
LARGEST_SLOPE_STD = cython.declare(cython.double, 0.15)
"""The slope of a run must be known to this, one sigma per s, before it proves anything."""
LARGEST_SCATTER = cython.declare(cython.double, 9.0)
"""How far the scatter about the line may be beyond the stated variance."""
LARGEST_SHARE = cython.declare(cython.double, 9.0)
"""Largest learnt share that one look may show: noise is understated at most three times."""
SIGMAS = cython.declare(cython.double, 3.0)


def count_verdict(x: State, aid: int, verdict: int) -> None:
    """Count the verdict on one measurement."""
    x.count[aid][verdict] += 1.0


def count_heading(x: State, verdict: int, azimuth: float) -> None:
    """Count the verdict on a heading, by its kind of sensor as well."""
    if azimuth >= AZIMUTH_MAGNETIC:
        azimuth = AZIMUTH_MAGNETIC
    sensor = cython.cast(cython.Py_ssize_t, azimuth - 1.0)
    x.heading_count[sensor][verdict] += 1.0
    x.count[AID_HEADING][verdict] += 1.0


def count_judged(x: State, aid: int, verdict: int) -> None:
    """Count the verdict on an observation that was judged; a heading is of the azimuth in use."""
    if aid == AID_HEADING:
        count_heading(x, verdict, x.azimuth)
    else:
        count_verdict(x, aid, verdict)


def is_timed_out(x: State, aid: int, limit: float) -> bool:
    """Return whether an aid has not been used for longer than its limit, s."""
    return x.t - x.used_t[aid] > limit * 1e9


def is_shown(x: State, k: Parameters, limit: float) -> bool:
    """Return whether an aid that shows position or velocity was fused within a time, s."""
    for aid in range(AIDS):
        is_there = cython.declare(cython.bint, k.aid[aid].shows != 0.0 and x.has_aid[aid] != 0.0)
        if is_there and not is_timed_out(x, aid, limit):
            return True
    return False


def is_refused_for(x: State, aid: int, limit: float) -> bool:
    """Return whether all of an aid have been refused for longer than a time, s."""
    return x.refused_t[aid] > x.used_t[aid] and x.t - x.refused_t[aid] > limit * 1e9


def has_run_for(x: State, aid: int, limit: float) -> bool:
    """Return whether a receiver's aid has been heard and refused for longer than a time, s."""
    return x.run[aid].n > 0.0 and x.t - x.run[aid].t0 > limit * 1e9


def is_running(x: State, aid: int) -> bool:
    """Return whether the last of a receiver's aid were refused, and more than one."""
    if x.refused_t[aid] <= x.used_t[aid]:
        return False
    # a long run begins anew
    return x.run[aid].n >= 2.0 or x.refused_t[aid] < x.run[aid].t0


def fuse(x: State, k: Parameters, o: Observation, aid: int) -> bool:
    """Fuse an observation if it passes the gate, and keep the account; return whether it did."""
    return fuse_judged(x, k, o, aid, innovate(x, o), False)


def fuse_judged(
    x: State, k: Parameters, o: Observation, aid: int, nis: float, is_denied: bool
) -> bool:
    """Fuse an observation that has been judged, in full or in part, or refuse it.

    Args:
        x: The state.
        k: The parameters.
        o: The observation, as :func:`~.update.innovate` leaves it.
        aid: Which aid it is of.
        nis: Its normalised innovation squared; NaN: there is no covariance to judge it by.
        is_denied: Other evidence says that it is wrong, whatever its NIS is.

    Returns:
        Whether it was fused.
    """
    hard = k.gate[o.rows - 1]
    soft = k.soft_gate[o.rows - 1]
    x.ratio[aid] = nis / hard
    x.is_denied[aid] = 1.0 if is_denied else 0.0
    x.nis_sum[aid] += (nis if nis < hard and not is_denied else hard) / o.rows
    x.nis_n[aid] += 1.0
    if o.has_bank and not isnan(nis):
        hypotheses.judge(x, k, o, aid)
        if k.weighs_faults == WEIGH_ACT and hypotheses.open_rows(x, k, o, aid):
            nis = innovate(x, o)
    if is_denied or not nis <= hard:
        count_judged(x, aid, VERDICT_DENIED if nis <= hard else VERDICT_GATED)
        if x.refused_t[aid] <= x.used_t[aid]:
            x.refused_t[aid] = x.t
        if aid < AID_HEADING:
            add_to_run(x, o, aid)
        if o.has_bank:
            o.bank[0].is_observed = 0
        return False
    if nis > soft:
        inflate_noise(o, nis / soft)
        count_judged(x, aid, VERDICT_DEWEIGHTED)
    else:
        count_judged(x, aid, VERDICT_FUSED)
    if aid == AID_HEADING:
        apply_yaw_update(x, o)
    else:
        apply_update(x, o)
    if nis > soft:  # one that is hardly believed ends no run of refused ones
        x.used_t[aid] = x.t
    else:
        note_used(x, aid)
    return True


def note_used(x: State, aid: int) -> None:
    """Note that an aid was fused, or reset the state: its run of refusals ends."""
    if aid < AID_HEADING:
        x.run[aid].n = 0.0
    x.used_t[aid] = x.t


def follow_share(share: float, seen: float, noise: float, own: float, memory: float) -> float:
    """Return a learnt share of a stated variance after one more look at it, ``memory`` looks long.

    Where the filter's own variance is large beside the noise a look tells little, and weighs less.
    """
    seen = seen if seen < LARGEST_SHARE else LARGEST_SHARE
    seen = seen if seen > -LARGEST_SHARE else -LARGEST_SHARE
    weight = noise / (noise + own)
    return share + weight * weight * (seen - share) / memory


def score(x: State, o: Observation, nis: float, gate: float) -> None:
    """Add a judged observation to the log-likelihood; an outlier counts as its gate.

    A NIS of NaN, where there is no covariance to judge by, counts nothing.

    Nothing in the filter reads the sum: it compares settings over the same log.
    """
    cost = nis if nis < gate else gate
    if isnan(nis):
        return
    for r in range(o.rows):
        cost += 2.0 * log(o.L[r][r])
    x.log_likelihood -= 0.5 * cost


def begin_reset(x: State, reason: float) -> None:
    """Count a reset; what it moves is added to ``x.moved`` afterwards."""
    x.resets += 1.0
    x.reset_reason = reason
    x.reset_t = x.t
    for i in range(3):
        x.moved.pos_n[i] = 0.0
        x.moved.vel_n[i] = 0.0
    x.moved.yaw = 0.0


def go_by_fixes(x: State) -> None:
    """Go by the fixes alone from the next one on, until they have shown the attitude."""
    x.needs_reset = NEEDS_FIX
    x.alignment.motion.has_fix = 0.0
    x.alignment.reference.is_known = 0.0


def add_to_run(x: State, o: Observation, aid: int) -> None:
    """Add the innovations that were refused to the run of a receiver's aid."""
    tau = (x.t - x.run[aid].t0) * 1e-9
    if x.run[aid].n == 0.0 or tau > LONGEST_RUN:
        clear_run(x, aid)
        x.run[aid].t0 = x.t
        tau = 0.0
    x.run[aid].n += 1.0
    x.run[aid].t += tau
    x.run[aid].tt += tau * tau
    for r in range(o.rows):
        x.run[aid].z[r] += o.z[r]
        x.run[aid].tz[r] += tau * o.z[r]
        x.run[aid].zz += o.z[r] * o.z[r]


def clear_run(x: State, aid: int) -> None:
    """Clear the run of an aid."""
    x.run[aid].n = 0.0
    x.run[aid].t0 = 0.0
    x.run[aid].t = 0.0
    x.run[aid].tt = 0.0
    x.run[aid].zz = 0.0
    for r in range(3):
        x.run[aid].z[r] = 0.0
        x.run[aid].tz[r] = 0.0


def is_proven(x: State, aid: int, rows: int, stated: float, drift: float, shortest: float) -> bool:
    """Return whether the run of a receiver's aid is consistent, so that the state is reset to it.

    Args:
        x: The state.
        aid: Whose run.
        rows: Rows of its observations.
        stated: Variance that the receiver states for one row.
        drift: Variance of our own drift, per s^2: what slope says nothing against the aid.
        shortest: Least duration of the run, s.
    """
    n = x.run[aid].n
    largest = 0.0
    scatter = x.run[aid].zz
    if n < FEWEST or x.t - x.run[aid].t0 < shortest * 1e9:
        return False
    spread = x.run[aid].tt - x.run[aid].t * x.run[aid].t / n
    if not spread > 0.0:
        return False

    # The line, and the scatter about it
    for r in range(rows):
        slope = x.run[aid].tz[r] - x.run[aid].t * x.run[aid].z[r] / n
        scatter -= x.run[aid].z[r] * x.run[aid].z[r] / n + slope * slope / spread
        slope = fabs(slope / spread)
        largest = slope if slope > largest else largest
    scatter = scatter / (rows * (n - 2.0))
    if not scatter <= LARGEST_SCATTER * stated:
        return False

    # A slope that is none, as far as it is known, and known well enough
    if scatter < 0.0:
        scatter = 0.0
    return scatter / spread <= LARGEST_SLOPE_STD * LARGEST_SLOPE_STD and largest <= SIGMAS * sqrt(
        scatter / spread + drift
    )

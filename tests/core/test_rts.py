"""The smoother against a batch solution, against itself, and against what is possible."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.core.memory.enums import (
    E_ATT,
    E_BG,
    E_DELAY,
    E_POS,
    E_VEL,
    Aid,
    Link,
    Mode,
    N,
)
from ekf_companion.core.memory.overlay import as_state, copy_state
from ekf_companion.core.memory.parameters import PARAMETERS
from ekf_companion.core.memory.scratch import OUT, Event, Fix, Scratch, TapeRecord
from ekf_companion.core.memory.state import BLOCK, State
from ekf_companion.core.order.timeline import Timeline
from ekf_companion.core.rts import Smoother
from ekf_companion.core.settings.from_settings import delays_ns, parameters
from ekf_companion.core.settings.settings import FilterSettings, GnssSettings
from ekf_companion.filters.gap import lost_motion
from ekf_companion.nav.measurements import Events, Kind
from tests.core.flights import between, flight
from tests.core.interpreted import load
from tests.core.states import a_state, array, copy, let_walk, minus, some_parameters

KNOWN = FilterSettings(gnss=GnssSettings(delay=0.12, delay_std=0.02, white_share=1.0))
TINY = 1e-7
"""All sigmas are so small that nothing is bent: second orders are as small again, relatively."""


def rows_of(events: Events, settings: FilterSettings = KNOWN) -> np.ndarray:
    """Return what a timeline went through, in its order."""
    timeline = Timeline(
        parameters(settings, "unknown"),
        delays_ns(settings, "unknown"),
        2_000_000_000,
        keeps_history=True,
    )
    samples = np.count_nonzero(events.kind == Kind.IMU)
    out = np.zeros((samples, OUT))
    timeline.run_log(
        events.t_ns, events.kind, events.values, np.zeros(samples, dtype=np.int64), out
    )
    return np.concatenate([rows for _, _, _, rows in timeline.history(True)])


def smoother(settings: FilterSettings = KNOWN, kind=Smoother):
    return kind(parameters(settings, "unknown"))


def first(one: Smoother) -> tuple[np.ndarray, np.ndarray]:
    """Return the state at the start, and its fault hypotheses."""
    return np.zeros(BLOCK), one.bank()


def go(one: Smoother, start: tuple[np.ndarray, np.ndarray], rows: np.ndarray):
    """Advance from a state and its fault hypotheses; return those after the rows."""
    one.set_bank(start[1])
    return one.advance(start[0], rows), one.bank()


def back(one: Smoother, start: tuple[np.ndarray, np.ndarray], rows: np.ndarray, later):
    """Smooth from a state and its fault hypotheses."""
    one.set_bank(start[1])
    return one.smooth(start[0], rows, later)


MODES = pytest.mark.parametrize(
    "settings", [KNOWN, replace(KNOWN, weigh_faults="act")], ids=["off", "act"]
)


def records(blocks: np.ndarray) -> np.ndarray:
    """Return state blocks as records, shape (n,)."""
    return blocks.view(np.dtype(State))[:, 0]


def kinds(rows: np.ndarray) -> np.ndarray:
    """Return the kinds of rows."""
    return rows.view(np.dtype(Event))[:, 0]["kind"]


def with_tape(count: int) -> Scratch:
    """Return scratch memory with a tape of so many records."""
    w = Scratch()
    w.tape.record = (TapeRecord * count)()
    w.tape.is_on = 1
    return w


class Batch:
    """The same problem as one least-squares problem: unit normal numbers u, and what they make."""

    def __init__(self, P: np.ndarray) -> None:
        self.A = np.linalg.cholesky(P)  # the error of now is A u + b
        self.b = np.zeros(N)
        self.rows: list[tuple[np.ndarray, np.ndarray]] = []
        self.kept: list[tuple[np.ndarray, np.ndarray]] = []

    def move(self, Phi: np.ndarray, Q: np.ndarray) -> None:
        values, vectors = np.linalg.eigh(Q)
        kept = values > 1e-12 * values.max()
        noise = vectors[:, kept] * np.sqrt(values[kept])
        self.A, self.b = np.hstack([Phi @ self.A, noise]), Phi @ self.b

    def measure(self, H: np.ndarray, z: np.ndarray, R: np.ndarray) -> None:
        root = np.linalg.inv(np.linalg.cholesky(R))
        self.rows.append((root @ H @ self.A, root @ (z - H @ self.b)))

    def solve(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return mean and covariance of the error at each time that was kept."""
        n = self.A.shape[1]
        stack = [np.eye(n)] + [np.pad(a, ((0, 0), (0, n - a.shape[1]))) for a, _ in self.rows]
        right = np.concatenate([np.zeros(n)] + [z for _, z in self.rows])
        u, *_ = np.linalg.lstsq(np.vstack(stack), right, rcond=None)
        C = np.linalg.inv(np.vstack(stack).T @ np.vstack(stack))
        return [
            (A @ u[: A.shape[1]] + b, A @ C[: A.shape[1], : A.shape[1]] @ A.T) for A, b in self.kept
        ]


def test_on_a_linear_problem_it_is_the_batch_least_squares_solution():
    core, rng = load(), np.random.default_rng(11)
    k, numbers = some_parameters(), np.zeros(PARAMETERS)
    k.gyro_noise, k.accel_noise = 0.2 * TINY, 2 * TINY
    let_walk(k, Aid.BARO, TINY)
    k.aid[Aid.BARO].std = TINY
    k.gyro_bias_walk, k.accel_bias_walk = 0.1 * TINY, 0.5 * TINY
    numbers[:] = np.frombuffer(k)
    smoothing = core.rts.Smoother(numbers)
    w = smoothing.w = with_tape(400)
    x = smoothing.x
    copy_state(x, a_state(11))
    x.heading_std, x.mode = TINY, Mode.NAVIGATE
    root = rng.normal(0.0, TINY, (N, N))
    array(x.P)[:] = root @ root.T
    core.tape.record_sample(x, w)
    batch = Batch(np.array(x.P))
    batch.kept.append((batch.A, batch.b))
    live = [copy(x)]
    # all of them optimal: what leaves the delay alone is no least-squares solution
    o, fix = w.observation, Fix()
    fix.std[:] = [TINY] * 3

    def update() -> None:
        m = o.rows
        array(o.z)[:m] = rng.normal(0.0, TINY, m)
        H, z, R = np.array(o.H)[:m], np.array(o.z)[:m], np.diag(np.diag(np.array(o.R))[:m])
        o.shows_delay = 1
        core.update.innovate(x, o)
        core.update.apply_update(x, o)
        batch.measure(H, z, R)
        batch.b = batch.b - np.array(o.dx)

    for step in range(1, 31):
        before = np.array(x.P)
        w.motion.rate[:], w.motion.force[:] = [0.1, -0.2, 0.1], [1.5, -2.0, -9.0]
        core.strapdown.integrate_strapdown(x, k, w.motion, 0.1)
        core.process_noise.scale_noise(x, k, w.motion)
        core.covariance.propagate_covariance(x, k, w.motion)
        core.tape.record_motion(x, k, w, 0.1)
        Phi = np.array(w.tape.record[w.tape.length - 1].Phi)
        batch.move(Phi, np.array(x.P) - Phi @ before @ Phi.T)
        if step % 3 == 0:
            fix.lat = x.origin.lat + x.pos_n[0] / x.origin.scale_n
            fix.lon = x.origin.lon + x.pos_n[1] / x.origin.scale_e
            core.gnss.position(x, k, fix, o)
            update()
        if step % 4 == 0:
            fix.vel_n[:] = x.vel_n
            core.gnss.velocity(x, k, fix, o)
            update()
        if step % 5 == 0:
            core.baro.observe(x, k, o, [0.0])
            update()
            core.tape.record_event(x, w)
        if step == 12:  # a gap
            core.tape.record_event(x, w)
            extra = np.zeros(N)
            extra[[0, 1, E_VEL, E_POS + 2]] = TINY**2
            array(x.P)[:] += np.diag(extra)
            core.tape.record_gap(x, w)
            batch.move(np.eye(N), np.diag(extra))
        if step == 20:  # a position set anew, after an update of other states in the same event
            array(x.pos_n)[:2] += 0.7
            core.slow_error.reset_variance(x, E_POS, 2, TINY**2)
            core.tape.record_event(x, w)
            keep = np.ones(N)
            keep[E_POS : E_POS + 2] = 0.0
            batch.move(np.diag(keep), np.diag(1.0 - keep) * TINY**2)
        core.tape.record_sample(x, w)
        batch.kept.append((batch.A, batch.b))
        live.append(copy(x))

    copy_state(smoothing.y, x)
    blocks = np.zeros((31, BLOCK))
    smoothing._back(blocks)
    moved = 0.0
    for block, now, (mean, C) in zip(blocks, live, batch.solve(), strict=True):
        sigma = np.sqrt(np.diag(C))
        error = minus(as_state(block), now)
        moved = max(moved, np.abs(error / sigma).max())
        np.testing.assert_allclose(error / sigma, mean / sigma, atol=1e-6)
        scale = np.outer(sigma, sigma)
        np.testing.assert_allclose(np.array(as_state(block).P) / scale, C / scale, atol=1e-6)
    assert moved > 1.0


@MODES
def test_interpreted_and_compiled_agree_to_the_last_bit(settings):
    events, _ = flight("figure-eight", duration=12.0, rate=50.0, yaw=True)
    rows = rows_of(events.take(between(events, 3.2, 5.8)))
    ends = []
    for kind in (Smoother, load().rts.Smoother):
        one = smoother(settings, kind)
        start = go(one, first(one), rows[:50])
        later = back(one, go(one, start, rows[50:200]), rows[200:], None)
        blocks = back(one, start, rows[50:200], later[0])
        ends.append((blocks.tobytes(), one.describe(blocks[1:]).tobytes()))
        assert as_state(blocks[-1]).mode == Mode.NAVIGATE
    assert ends[0] == ends[1]


@MODES
def test_a_flight_in_pieces_is_smoothed_as_in_one_piece(settings):
    events, _ = flight("figure-eight", duration=20.0, rate=50.0)
    rows, one = rows_of(events), smoother(settings)
    starts = [first(one)]
    whole = one.smooth(np.zeros(BLOCK), rows, None)
    ends = np.flatnonzero(kinds(rows) == Kind.IMU)[[150, 151, 400, 700, -1]] + 1
    for begin, end in zip([0, *ends], ends, strict=False):
        starts.append(go(one, starts[-1], rows[begin:end]))
    later, parts = None, []
    for index in reversed(range(5)):
        blocks = back(one, starts[index], rows[[0, *ends][index] : ends[index]], later)
        later = blocks[0]
        parts.insert(0, blocks[1:])
    np.testing.assert_allclose(np.concatenate(parts), whole[1:], rtol=1e-9, atol=1e-12)


@MODES
def test_the_last_estimate_is_that_of_the_filter_and_no_sigma_is_larger_than_its(settings):
    events, _ = flight("figure-eight", duration=30.0, rate=50.0)
    rows, one = rows_of(events), smoother(settings)
    now, live, begin = first(one), [], 0
    blocks = one.smooth(np.zeros(BLOCK), rows, None)[1:]
    for end in np.flatnonzero(kinds(rows) == Kind.IMU) + 1:
        now = go(one, now, rows[begin:end])
        live.append(now[0])
        begin = end
    live = np.array(live)
    np.testing.assert_allclose(blocks[-1], live[-1], rtol=1e-12, atol=1e-15)
    late = records(live)["mode"] == Mode.NAVIGATE
    sigmas = [np.sqrt(np.diagonal(records(b)["P"][late], axis1=1, axis2=2)) for b in (blocks, live)]
    # yaw may be worse by what the injected errors bend it: a share of 1e-3
    assert (sigmas[0] <= sigmas[1] * 1.001).all()
    assert (sigmas[0][:, :9].mean(axis=0) < 0.8 * sigmas[1][:, :9].mean(axis=0)).all()
    # what is not of the state is as the filter had it
    for name in ("mode", "gyro", "accel", "t", "samples", "resets"):
        assert np.array_equal(records(blocks)[name], records(live)[name]), name
    # and before there was an attitude, all is
    early = records(live)["mode"] < Mode.ATTITUDE
    assert early.any()
    assert np.array_equal(blocks[early], live[early], equal_nan=True)


def test_a_state_that_is_known_stays_what_it_is():
    events, _ = flight("figure-eight", duration=20.0, rate=50.0)
    settings = FilterSettings(gnss=GnssSettings(delay=0.12, delay_std=0.0, white_share=1.0))
    blocks = smoother(settings).smooth(np.zeros(BLOCK), rows_of(events, settings), None)
    assert not records(blocks)["gnss_delay"].any()
    assert not records(blocks)["P"][:, E_DELAY].any()
    assert np.isfinite(records(blocks)["P"]).all()


@pytest.mark.parametrize("zeros", [[], [4, 9]])
def test_what_the_others_know_needs_no_gain_of_its_own(zeros):
    rts, rng = load().rts, np.random.default_rng(9)
    root = rng.normal(0.0, 1.0, (N, N - 3))  # three states too many
    root[zeros] = 0.0
    P, B = root @ root.T, root @ rng.normal(0.0, 1.0, (N - 3, N))
    U, X = P.copy(), B.copy()
    rts.factor(U, N)
    rts.solve(U, X, N)
    np.testing.assert_allclose(P @ X, B, atol=1e-8)
    assert np.count_nonzero(np.diag(U) == 0.0) >= 3
    assert not X[zeros].any()


def test_records_say_what_follows_from_what():
    core = load()
    x, w = a_state(1), with_tape(20)
    x.mode = Mode.LEVEL
    core.tape.record_sample(x, w)
    core.tape.record_sample(x, w)  # no attitude yet
    x.mode = Mode.ATTITUDE
    core.tape.record_sample(x, w)  # the first
    core.tape.record_event(x, w)
    core.slow_error.reset_variance(x, E_VEL, 3, 1.0)
    core.tape.record_event(x, w)
    core.slow_error.reset_variance(x, E_BG, 1, 1.0)
    core.slow_error.reset_variance(x, E_ATT + 2, 1, 1.0)
    core.tape.record_sample(x, w)
    core.tape.record_sample(x, w)
    x.mode = Mode.LEVEL
    core.tape.record_sample(x, w)
    links = [w.tape.record[i].link for i in range(w.tape.length)]
    cut, same, fresh = Link.CUT, Link.SAME, Link.FRESH
    assert links == [cut, cut, cut, same, fresh, cut, same, cut]


def test_what_a_gap_adds_is_noise_of_its_own():
    events, _ = flight("figure-eight", duration=12.0, rate=50.0, yaw=True)
    rows = rows_of(events.take(between(events, 3.2, 4.5)))
    late = rows[-1:].copy()
    late.view(np.dtype(Event))["t"] += 5e8
    one = smoother(kind=load().rts.Smoother)
    blocks = one.smooth(one.advance(np.zeros(BLOCK), rows), late, None)
    tape = [one.w.tape.record[i] for i in range(one.w.tape.length)]
    assert [record.link for record in tape[1:]] == [Link.MOVED, Link.MOVED, Link.SAME]
    assert np.array_equal(tape[2].Phi, np.eye(N))
    grown = tape[2].state.P[0][0] - tape[1].state.P[0][0]
    assert grown == pytest.approx(lost_motion(0.5).tilt ** 2)
    # nothing was measured, so nothing is learnt of before
    np.testing.assert_allclose(np.array(as_state(blocks[0]).P), tape[0].state.P, rtol=1e-9)


def test_a_filter_with_a_tape_goes_where_one_without_goes():
    events, _ = flight("figure-eight", duration=12.0, rate=50.0, yaw=True)
    rows = rows_of(events.take(between(events, 3.2, 4.6)))
    one = smoother(kind=load().rts.Smoother)
    one.smooth(np.zeros(BLOCK), rows, None)
    assert one.x.mode == Mode.NAVIGATE
    assert bytes(one.x) == smoother().advance(np.zeros(BLOCK), rows).tobytes()

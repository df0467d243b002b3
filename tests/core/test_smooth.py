"""The smoother against a batch solution, against itself, and against what is possible."""

import numpy as np
import pytest

from ekf_companion.core import state as at
from ekf_companion.core.settings import FilterSettings, GnssSettings, delays_ns, parameters
from ekf_companion.core.smooth import Smoother
from ekf_companion.core.timeline import Timeline
from ekf_companion.nav.measurements import Events, Kind
from tests.core.flights import between, flight
from tests.core.interpreted import load
from tests.core.test_observe import a_state
from tests.core.test_observe import parameters as bare
from tests.core.test_propagate import errors_between

KNOWN = FilterSettings(gnss=GnssSettings(delay=0.12, delay_std=0.02, white_share=1.0))
TINY = 1e-7
"""All sigmas are so small that nothing is bent: second orders are as small again, relatively."""


def rows_of(events: Events, settings: FilterSettings = KNOWN) -> np.ndarray:
    """Give what a timeline went through, in its order."""
    timeline = Timeline(
        parameters(settings, "unknown"),
        delays_ns(settings, "unknown"),
        2_000_000_000,
        keeps_history=True,
    )
    samples = np.count_nonzero(events.kind == Kind.IMU)
    out = np.zeros((samples, at.OUT))
    timeline.run_log(
        events.t_ns, events.kind, events.values, np.zeros(samples, dtype=np.int64), out
    )
    return np.concatenate([rows for _, _, _, rows in timeline.history(True)])


def smoother(settings: FilterSettings = KNOWN, kind=Smoother):
    return kind(parameters(settings, "unknown"))


def covariance(block: np.ndarray) -> np.ndarray:
    return block[at.X_COV :].reshape(at.N, at.N)


class Batch:
    """The same problem as one least-squares problem: unit normal numbers u, and what they make."""

    def __init__(self, P: np.ndarray) -> None:
        self.A = np.linalg.cholesky(P)  # the error of now is A u + b
        self.b = np.zeros(at.N)
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
        """Give mean and covariance of the error at each time that was kept."""
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
    x, k = a_state(11), bare()
    k[at.K_GYRO_NOISE], k[at.K_ACCEL_NOISE], k[at.K_BARO_WALK] = 0.2 * TINY, 2 * TINY, TINY
    k[at.K_GYRO_WALK], k[at.K_ACCEL_WALK], x[at.X_HEADING_STD] = 0.1 * TINY, 0.5 * TINY, TINY
    x[at.X_MODE] = at.MODE_NAVIGATE
    root = rng.normal(0.0, TINY, (at.N, at.N))
    x[at.X_COV :] = (root @ root.T).ravel()
    smoothing = core.smooth.Smoother(k)
    smoothing.x[:] = x
    w = smoothing.w = np.zeros(at.TAPE + 400 * at.RECORD)
    x = smoothing.x
    core.tape.noted(x, w, True)
    batch = Batch(covariance(x).copy())
    batch.kept.append((batch.A, batch.b))
    live = [x.copy()]

    def update(m: int) -> None:
        w[at.W_Z : at.W_Z + m] += rng.normal(0.0, TINY, m)
        H = w[at.W_H : at.W_H + m * at.N].reshape(m, at.N).copy()
        z, R = w[at.W_Z : at.W_Z + m].copy(), np.diag(w[at.W_R : at.W_R + 9 : 4][:m]).copy()
        core.correct.innovate(x, w, m)
        core.correct.absorb(x, w, m)
        batch.measure(H, z, R)
        batch.b = batch.b - w[at.W_DX : at.W_DX + at.N]

    w[at.W_FIX + 6 : at.W_FIX + 9] = TINY
    for step in range(1, 31):
        before = covariance(x).copy()
        w[at.W_RATE : at.W_RATE + 6] = [0.1, -0.2, 0.1, 1.5, -2.0, -9.0]
        core.propagate.move(x, k, w, 0.1)
        core.propagate.spread(x, k, w, 0.1)
        core.tape.moved(x, k, w, 0.1)
        first = at.TAPE + (int(w[at.TAPE_COUNT]) - 1) * at.RECORD
        Phi = w[first + at.T_PHI : first + at.RECORD].reshape(at.N, at.N).copy()
        batch.move(Phi, covariance(x) - Phi @ before @ Phi.T)
        if step % 3 == 0:
            lat = x[at.X_LAT0] + x[at.X_POS] / x[at.X_SCALE_N]
            lon = x[at.X_LON0] + x[at.X_POS + 1] / x[at.X_SCALE_E]
            w[at.W_FIX : at.W_FIX + 2] = lat, lon
            core.observe.position(x, k, w)
            w[at.W_Z : at.W_Z + 2] = 0.0
            update(2)
        if step % 4 == 0:
            w[at.W_FIX + 3 : at.W_FIX + 6] = x[at.X_VEL : at.X_VEL + 3]
            core.observe.velocity(x, k, w)
            w[at.W_Z : at.W_Z + 3] = 0.0
            update(3)
        if step % 5 == 0:
            core.observe.pressure_altitude(x, w, 0.0, TINY)
            w[at.W_Z] = 0.0
            update(1)
            core.tape.noted(x, w, False)
        if step == 12:  # doubt
            core.tape.noted(x, w, False)
            extra = np.zeros(at.N)
            extra[[0, 1, at.E_VEL, at.E_POS + 2]] = TINY**2
            x[at.X_COV :: at.N + 1] += extra
            core.tape.doubted(x, w)
            batch.move(np.eye(at.N), np.diag(extra))
        if step == 20:  # a position set anew, after an update of other states in the same event
            x[at.X_POS : at.X_POS + 2] += 0.7
            core.correct.forget(x, at.E_POS, 2, TINY**2)
            core.tape.noted(x, w, False)
            keep = np.ones(at.N)
            keep[at.E_POS : at.E_POS + 2] = 0.0
            batch.move(np.diag(keep), np.diag(1.0 - keep) * TINY**2)
        core.tape.noted(x, w, True)
        batch.kept.append((batch.A, batch.b))
        live.append(x.copy())

    smoothing.y[:] = x
    blocks = np.zeros((31, at.BLOCK))
    smoothing.back(blocks)
    moved = 0.0
    for block, now, (mean, C) in zip(blocks, live, batch.solve(), strict=True):
        sigma = np.sqrt(np.diag(C))
        error = errors_between(now, block)
        moved = max(moved, np.abs(error / sigma).max())
        np.testing.assert_allclose(error / sigma, mean / sigma, atol=1e-6)
        scale = np.outer(sigma, sigma)
        np.testing.assert_allclose(covariance(block) / scale, C / scale, atol=1e-6)
    assert moved > 1.0


def test_interpreted_and_compiled_agree_to_the_last_bit():
    events, _ = flight("figure-eight", duration=12.0, rate=50.0, yaw=True)
    rows = rows_of(events.take(between(events, 3.2, 5.8)))
    ends = []
    for kind in (Smoother, load().smooth.Smoother):
        one = smoother(kind=kind)
        start = one.advance(np.zeros(at.BLOCK), rows[:50])
        later = one.smooth(one.advance(start, rows[50:200]), rows[200:], None)
        blocks = one.smooth(start, rows[50:200], later[0])
        ends.append((blocks.tobytes(), one.describe(blocks[1:]).tobytes()))
        assert blocks[-1, at.X_MODE] == at.MODE_NAVIGATE
    assert ends[0] == ends[1]


def test_a_flight_in_pieces_is_smoothed_as_in_one_piece():
    events, _ = flight("figure-eight", duration=20.0, rate=50.0)
    rows, one = rows_of(events), smoother()
    whole = one.smooth(np.zeros(at.BLOCK), rows, None)
    ends = np.flatnonzero(rows[:, at.ROW_KIND] == Kind.IMU)[[150, 151, 400, 700, -1]] + 1
    starts = [np.zeros(at.BLOCK)]
    for first, end in zip([0, *ends], ends, strict=False):
        starts.append(one.advance(starts[-1], rows[first:end]))
    later, parts = None, []
    for index in reversed(range(5)):
        blocks = one.smooth(starts[index], rows[[0, *ends][index] : ends[index]], later)
        later = blocks[0]
        parts.insert(0, blocks[1:])
    np.testing.assert_allclose(np.concatenate(parts), whole[1:], rtol=1e-9, atol=1e-12)


def test_the_last_estimate_is_that_of_the_filter_and_no_sigma_is_larger_than_its():
    events, _ = flight("figure-eight", duration=30.0, rate=50.0)
    rows, one = rows_of(events), smoother()
    blocks = one.smooth(np.zeros(at.BLOCK), rows, None)[1:]
    live, first = [np.zeros(at.BLOCK)], 0
    for end in np.flatnonzero(rows[:, at.ROW_KIND] == Kind.IMU) + 1:
        live.append(one.advance(live[-1], rows[first:end]))
        first = end
    live = np.array(live[1:])
    np.testing.assert_allclose(blocks[-1], live[-1], rtol=1e-12, atol=1e-15)
    late = live[:, at.X_MODE] == at.MODE_NAVIGATE
    sigmas = [np.sqrt(b[late][:, at.X_COV :: at.N + 1]) for b in (blocks, live)]
    # yaw may be worse by what the injected errors bend it: a share of 1e-3
    assert (sigmas[0] <= sigmas[1] * 1.001).all()
    assert (sigmas[0][:, :9].mean(axis=0) < 0.8 * sigmas[1][:, :9].mean(axis=0)).all()
    # what is not of the state is as the filter had it
    same = [at.X_MODE, at.X_GYRO, at.X_ACCEL, at.X_T, at.X_SAMPLES, at.X_RESETS]
    assert np.array_equal(blocks[:, same], live[:, same])
    # and before there was an attitude, all is
    early = live[:, at.X_MODE] < at.MODE_ATTITUDE
    assert early.any()
    assert np.array_equal(blocks[early], live[early], equal_nan=True)


def test_a_state_that_is_known_stays_what_it_is():
    events, _ = flight("figure-eight", duration=20.0, rate=50.0)
    settings = FilterSettings(gnss=GnssSettings(delay=0.12, delay_std=0.0, white_share=1.0))
    blocks = smoother(settings).smooth(np.zeros(at.BLOCK), rows_of(events, settings), None)
    delay = at.X_COV + at.E_DELAY * at.N
    assert not blocks[:, at.X_DELAY].any()
    assert not blocks[:, delay : delay + at.N].any()
    assert np.isfinite(blocks[:, at.X_COV :]).all()


@pytest.mark.parametrize("zeros", [[], [4, 9]])
def test_what_the_others_know_needs_no_gain_of_its_own(zeros):
    hindsight, rng = load().hindsight, np.random.default_rng(9)
    root = rng.normal(0.0, 1.0, (at.N, at.N - 3))  # three states too many
    root[zeros] = 0.0
    P, B = root @ root.T, root @ rng.normal(0.0, 1.0, (at.N - 3, at.N))
    U, X = P.copy(), B.copy()
    hindsight.factor(U)
    hindsight.solve(U, X)
    np.testing.assert_allclose(P @ X, B, atol=1e-8)
    assert np.count_nonzero(np.diag(U) == 0.0) >= 3
    assert not X[zeros].any()


def test_records_say_what_follows_from_what():
    core = load()
    x, w = a_state(1), np.zeros(at.TAPE + 20 * at.RECORD)
    x[at.X_MODE] = at.MODE_LEVEL
    core.tape.noted(x, w, True)
    core.tape.noted(x, w, True)  # no attitude yet
    x[at.X_MODE] = at.MODE_ATTITUDE
    core.tape.noted(x, w, True)  # the first
    core.tape.noted(x, w, False)
    core.correct.forget(x, at.E_VEL, 3, 1.0)
    core.tape.noted(x, w, False)
    core.correct.forget(x, at.E_BG, 1, 1.0)
    core.correct.forget(x, at.E_ATT + 2, 1, 1.0)
    core.tape.noted(x, w, True)
    core.tape.noted(x, w, True)
    x[at.X_MODE] = at.MODE_LEVEL
    core.tape.noted(x, w, True)
    count = int(w[at.TAPE_COUNT])
    links = w[at.TAPE : at.TAPE + count * at.RECORD].reshape(count, at.RECORD)[:, at.T_LINK]
    cut, same, fresh = at.LINK_CUT, at.LINK_SAME, at.LINK_FRESH
    assert links.tolist() == [cut, cut, cut, same, fresh, cut, same, cut]


def test_what_a_gap_adds_is_noise_of_its_own():
    events, _ = flight("figure-eight", duration=12.0, rate=50.0, yaw=True)
    rows = rows_of(events.take(between(events, 3.2, 4.5)))
    late = rows[-1:].copy()
    late[0, at.ROW_T] += 5e8
    one = smoother(kind=load().smooth.Smoother)
    blocks = one.smooth(one.advance(np.zeros(at.BLOCK), rows), late, None)
    count = int(one.w[at.TAPE_COUNT])
    records = one.w[at.TAPE : at.TAPE + count * at.RECORD].reshape(count, at.RECORD)
    assert records[1:, at.T_LINK].tolist() == [at.LINK_MOVED, at.LINK_MOVED, at.LINK_SAME]
    assert np.array_equal(records[2, at.T_PHI :].reshape(at.N, at.N), np.eye(at.N))
    grown = records[2, at.T_BLOCK : at.T_PHI] - records[1, at.T_BLOCK : at.T_PHI]
    assert covariance(grown)[0, 0] == pytest.approx((0.2 * 0.5) ** 2)
    # nothing was measured, so nothing is learnt of before
    np.testing.assert_allclose(
        covariance(blocks[0]), covariance(records[0, at.T_BLOCK : at.T_PHI]), rtol=1e-9
    )


def test_a_filter_with_a_tape_goes_where_one_without_goes():
    events, _ = flight("figure-eight", duration=12.0, rate=50.0, yaw=True)
    rows = rows_of(events.take(between(events, 3.2, 4.6)))
    one = smoother(kind=load().smooth.Smoother)
    one.smooth(np.zeros(at.BLOCK), rows, None)
    assert one.x[at.X_MODE] == at.MODE_NAVIGATE
    assert one.x.tobytes() == smoother().advance(np.zeros(at.BLOCK), rows).tobytes()

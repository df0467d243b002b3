"""Who is to blame for ODOMETRY that did not go out."""

from dataclasses import replace

import pytest

from ekf_companion.link.backlog import FRESH_NS
from ekf_companion.status.judge import judge
from ekf_companion.status.losses import Losses, Mark, apportion
from tests.status.test_observer import MS, Watched

LAG = FRESH_NS * 2


@pytest.mark.parametrize(
    ("marks", "lost"),
    [
        # The link is full, and the loop goes round
        ([Mark(0, 0, 0), Mark(15, 0, 0), Mark(30, 0, 0)], Losses(30, 0, 0)),
        # The loop was held up: before the loss, in it, or as noted after it
        ([Mark(0, 0, LAG), Mark(5, 5, 0), Mark(5, 5, 0)], Losses(0, 5, 0)),
        ([Mark(0, 0, 0), Mark(5, 5, LAG), Mark(5, 5, 0)], Losses(0, 5, 0)),
        ([Mark(0, 0, 0), Mark(5, 5, 0), Mark(5, 5, LAG)], Losses(0, 5, 0)),
        # What waited for room on a held-up loop too
        ([Mark(0, 0, 0), Mark(4, 0, LAG)], Losses(0, 4, 0)),
        # The samples came late, and the loop went round
        ([Mark(0, 0, 0), Mark(6, 6, 20 * MS)], Losses(0, 0, 6)),
        # A full link stays one, whatever the board did three seconds before
        (
            [Mark(0, 0, LAG), Mark(2, 2, 0), Mark(2, 2, 0), Mark(17, 0, 0), Mark(32, 2, 0)],
            Losses(30, 2, 0),
        ),
        # A short wait explains nothing
        ([Mark(0, 0, FRESH_NS - 1), Mark(3, 0, FRESH_NS - 1)], Losses(3, 0, 0)),
        # The queue shrank: what waited was sent after all
        ([Mark(4, 0, 0), Mark(3, 0, 0)], Losses(-1, 0, 0)),
        ([Mark(0, 0, 0)], Losses(0, 0, 0)),
    ],
)
def test_a_loss_is_blamed_on_what_held_it_up(marks, lost):
    assert apportion(marks) == lost


def held_up(seconds):
    """Return a companion in flight whose loop was held up for so long, and then read late."""
    watched = Watched().fly(12.0)
    watched.now_ns += round(seconds * 1e9)
    outbox, observer = watched.companion.session.outbox, watched.observer
    for _ in range(15):  # such as were too old when they could be sent
        outbox.sent["ODOMETRY"] += 1
        observer.on_stale()
    observer.tick(watched.now_ns)  # the reads that waited come before the timer
    observer.on_late_timer(seconds)
    watched.now_ns += 10 * MS
    observer.tick(watched.now_ns)
    return watched


def judged(watched):
    snapshot = watched.snapshot()
    link = replace(snapshot.link, is_open=True, silent_s=0.0)
    return judge(replace(snapshot, link=link, sample_age_s=0.0)).line


def test_a_board_that_lets_the_loop_wait_is_named_with_its_lag():
    words = judged(held_up(0.6))
    assert "3 Hz thrown away as this board let the daemon wait for 0.6 s: see what else" in words
    assert "the link takes no more" not in words


def test_samples_that_come_too_late_are_blamed_neither_on_the_link_s_room_nor_on_the_board():
    words = judged(held_up(0.01))
    assert "3 Hz thrown away as the samples came too late: check the radio" in words
    assert "takes no more" not in words
    assert "this board" not in words

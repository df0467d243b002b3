"""A short run of the campaign on damaged files (``make fuzz`` has the long one)."""

import logging

import pytest

from benchmarks.reliability.damaged import KINDS, Campaign, Outcome
from benchmarks.reliability.whole_files import whole_files
from ekf_companion.logs.ulog_messages import HEADER, MAGIC
from tests.logs import test_dataflash_instances
from tests.logs.test_ulog import small_log

MUTANTS = 15


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    logging.disable(logging.CRITICAL)
    flight = test_dataflash_instances.Flight()
    flight.lane, flight.fuses = (lambda s: int(s >= 12)), (lambda lane, s: (lane, lane))
    built = {".bin": flight.write(), ".ulg": MAGIC + bytes(HEADER - len(MAGIC)) + small_log(n=400)}
    yield Campaign(whole_files() | built, tmp_path_factory.mktemp("damaged"))
    logging.disable(logging.NOTSET)


@pytest.mark.campaign
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind[:4] not in (".txt", ".mat")])
def test_any_damage_ends_in_an_estimate_or_a_sentence_in_bounded_memory_and_time(campaign, kind):
    assert campaign.run(kind, MUTANTS, seed=5).complaints == []


@pytest.mark.parametrize(
    ("outcome", "words"),
    [
        (Outcome(1000, 3, "ekf-companion: no log\n", 0.1, 1 << 27), ""),
        (Outcome(1000, 0, "wrote it\n", 0.1, 1 << 27), ""),
        (Outcome(1000, 1, "Traceback (most recent call last):\nValueError: 1", 0.1, 0), "a trace"),
        (Outcome(1000, -9, "", 0.1, 0), "exit code -9"),
        (Outcome(1000, 2, "ekf-companion: no log\n", 0.1, 0), "exit code 2"),
        (Outcome(1000, 3, "", 0.1, 0), "not one sentence"),
        (Outcome(1000, 3, "ekf-companion: no log\n", 0.1, 3 << 30), "3072 MiB"),
        (Outcome(1000, 0, "", 9.0, 0), "9.0 s for 1000 bytes"),
        (Outcome(4_000_000, 0, "", 9.0, 0), ""),
    ],
)
def test_what_is_wrong_with_an_outcome_is_named(outcome, words):
    complaint = outcome.complaint(".csv")
    assert complaint.startswith(words) if words else not complaint

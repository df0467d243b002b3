"""What Prometheus scrapes stays as it is: names, types, labels, help, values."""

from dataclasses import replace

from prometheus_client import generate_latest

from ekf_companion.status.metrics import registry_of
from tests.paths import ROOT
from tests.status.filled import filled

KEPT = ROOT / "tests" / "status" / "exposition.txt"


def exposition():
    snapshot = filled()
    texts = [
        generate_latest(registry_of(one)).decode()
        for one in (snapshot, replace(snapshot, peer=None, estimator=None, messages={}))
    ]
    return "\n".join("".join(sorted(text.splitlines(keepends=True))) for text in texts)


def test_names_types_labels_help_and_values_are_those_of_old():
    assert exposition() == KEPT.read_text()

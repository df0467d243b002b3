"""What Prometheus scrapes stays as it is: names, types, labels, help, values."""

from prometheus_client import generate_latest

from ekf_companion.status.metrics import registry_of
from tests.paths import ROOT
from tests.status.filled import filled

KEPT = ROOT / "tests" / "status" / "exposition.txt"


def exposition():
    """Return the lines of a snapshot in which every field is set, sorted: their order is free."""
    text = generate_latest(registry_of(filled())).decode()
    return "".join(sorted(text.splitlines(keepends=True)))


def test_names_types_labels_help_and_values_are_those_of_old():
    assert exposition() == KEPT.read_text()

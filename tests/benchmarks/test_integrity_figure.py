"""The picture of docs/INTEGRITY.md is drawn by a command, and shows what its text says."""

import sys

import numpy as np

from benchmarks import integrity_figure
from ekf_companion.core.memory.enums import Fault


def test_a_slide_is_named_and_drawn(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(sys, "argv", ["integrity_figure", "--out", str(tmp_path)])
    flown = []
    fly = integrity_figure.fly
    monkeypatch.setattr(
        integrity_figure, "fly", lambda *given: flown.append(fly(*given)) or flown[-1]
    )
    integrity_figure.main()
    assert (tmp_path / "integrity.png").read_bytes()[:4] == b"\x89PNG"
    act, default = flown
    assert [one.kind for one in act.found] == [Fault.POSITION_RAMP, Fault.POSITION_STEP]
    assert "GNSS position slides at 0." in capsys.readouterr().out
    assert np.nanmax(act.error) < 3.0
    assert 10.0 < np.nanmax(default.error) < 18.0
    late = act.evidence.t_ns > act.evidence.t_ns[0] + 15 * 10**9
    at = np.searchsorted(act.table.stamp_ns, act.evidence.t_ns[late])
    assert (act.error[at] < act.evidence.protection[late, 0]).all()

"""The whole project in one minute: the real daemon, a simulated flight, real UDP, a verdict."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from ekf_companion.errors import CompanionError
from ekf_companion.link.link import Link
from sim_autopilot import figure
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Flight
from sim_autopilot.fly import Flown, over, run, telling
from sim_autopilot.fly import fly as fly_over
from sim_autopilot.recording import write_score, write_truth
from sim_autopilot.score_table import TITLES

LIMITS = {
    "horizontal_m": 0.6,
    "vertical_m": 0.9,
    "velocity_mps": 0.15,
    "roll_deg": 0.5,
    "pitch_deg": 0.5,
    "yaw_deg": 1.5,
}
"""Of the RMS error after ten seconds."""
_START = 15.0
"""Longest time to the daemon's first answer, s."""
_STOP = 5.0
"""Longest time to its end, s."""


def fly(
    out: Path,
    *,
    duration: float,
    seed: int,
    daemon_config: Path | None = None,
    on_progress: Callable[[str], None] = lambda _: None,
) -> tuple[dict[str, Any], list[Path]]:
    """Fly figure-eight against the daemon; return the score, and the files that were written.

    ``on_progress`` is called with the present task, every four seconds or more often.

    Raises:
        CompanionError: The daemon did not start or never answered.
    """
    on_progress("planning the flight")
    out.mkdir(parents=True, exist_ok=True)
    flight = Flight.plan("figure-eight", SimConfig(), seed=seed, duration=duration)
    write_truth(out / "truth.csv", flight)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]

    async def body(link: Link) -> Flown:
        async with telling(duration, on_progress):
            return await fly_over(flight, link, wait=_START)

    with _daemon(daemon_config, port, out / "daemon.log"):
        flown = run(over(f"udpout:127.0.0.1:{port}", body))
    on_progress("comparing with the truth")
    score = flown.witness.score()
    score["pacing_late_ms"] = flown.pace.lateness()
    write_score(out / "score.json", score)
    files = [out / "score.json", out / "truth.csv", out / "daemon.log"]
    on_progress("drawing the figure")
    with contextlib.suppress(ImportError):
        figure.draw(out / "demo.png", flight, flown.witness, score)
        files.insert(0, out / "demo.png")
    return score, files


def complaints(score: dict[str, Any], log: Path) -> list[str]:
    """Return a sentence for each of ``LIMITS`` that a score exceeds."""
    if not score["odometry"]["scored"]:
        return [f"no ODOMETRY came that could be scored; {log} has the daemon's log"]
    return [
        f"{TITLES[key]}: RMS {score[key]['rms']:.3f} is above {limit}"
        for key, limit in LIMITS.items()
        if not score[key]["rms"] <= limit
    ]


@contextlib.contextmanager
def _daemon(config: Path | None, port: int, log: Path) -> Iterator[None]:
    """Run the daemon while the body runs; its log goes to a file."""
    command = [sys.executable, "-m", "ekf_companion", "run", "--link", f"udpin:127.0.0.1:{port}"]
    if config is not None:
        command += ["--config", str(config)]
    with (
        log.open("wb") as output,
        subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT) as process,
    ):
        try:
            yield
        finally:
            code = process.poll()
            process.terminate()
            try:
                process.wait(_STOP)
            except subprocess.TimeoutExpired:
                process.kill()
            if code is not None:
                raise CompanionError(f"the daemon ended by itself with exit code {code}; see {log}")

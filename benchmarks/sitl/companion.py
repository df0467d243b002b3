"""The daemon as a process beside a simulator."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from benchmarks.sitl.process import end


class Companion:
    """One daemon on one link; each of its runs records into a file of its own."""

    def __init__(self, folder: Path, link: str, settings: str = "") -> None:
        """Prepare a daemon.

        Args:
            folder: For its configuration, recordings, checkpoint and log.
            link: Where the simulator is: ``udpin:127.0.0.1:14540``.
            settings: YAML that is added to the configuration.
        """
        self.folder, self._link = folder, link
        self._config = folder / "companion.yaml"
        self._config.write_text(f"http: {{port: 0}}\n{settings}\n", encoding="utf-8")
        self._process: subprocess.Popen[bytes] | None = None
        self.runs = 0

    @property
    def recordings(self) -> list[Path]:
        """One .tlog for each run so far."""
        return [self.folder / f"companion-{run}.tlog" for run in range(1, self.runs + 1)]

    def start(self) -> None:
        """Start it, with the checkpoint of the run before."""
        self.runs += 1
        command = [sys.executable, "-m", "ekf_companion", "run", "--config", str(self._config)]
        command += ["--link", self._link, "--record", str(self.recordings[-1])]
        command += ["--checkpoint", str(self.folder / "checkpoint")]
        with (self.folder / f"companion-{self.runs}.log").open("wb") as log:
            self._process = subprocess.Popen(
                command, env=self._environment(), stdout=log, stderr=subprocess.STDOUT
            )

    def _environment(self) -> dict[str, str]:
        """Return the variables: with compiled modules at hand, as an installation leaves them."""
        mine = {**os.environ, "PYTHONPYCACHEPREFIX": str(self.folder / "modules")}
        mine.pop("PYTHONDONTWRITEBYTECODE", None)
        return mine

    def kill(self) -> None:
        """End it at once, as a crash does."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def stop(self) -> None:
        """End it orderly."""
        end(self._process)

"""Write the man page and the completions of shells from the commands: ``make reference``."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from ekf_companion.cli import COMMANDS, app
from ekf_companion.version import __version__
from tests.paths import ROOT

SHARE = ROOT / "systemd" / "share"
MAN = SHARE / "man/man1/ekf-companion.1"
COMPLETIONS = {
    "bash": SHARE / "bash-completion/completions/ekf-companion",
    "zsh": SHARE / "zsh/site-functions/_ekf-companion",
    "fish": SHARE / "fish/vendor_completions.d/ekf-companion.fish",
}
"""File by shell, where each looks for it below /usr/share."""
_SYNOPSIS = (".B ekf\\-companion", "[\\-\\-version] [\\-\\-help] \\fICOMMAND\\fR [\\fIOPTIONS\\fR]")
_PROGRAM = "from ekf_companion.cli import app; app(prog_name='ekf-companion')"
_LAST = r""".SH EXIT STATUS
.TP
.B 0
Done.
.TP
.B 1
A bug; a package of an extra is missing; no current estimate, or an invalid one (status); not
reloaded (reload).
.TP
.B 2
The command line or the configuration is wrong.
.TP
.B 3
The log cannot be read, or contains too little to estimate or calibrate.
.TP
.B 4
No daemon answers (status, reload).
.TP
.B 5
A stage fails (doctor).
.SH FILES
.TP
.I /etc/ekf\-companion/config.yaml
Configuration of the service; check\-config prints all keys.
.TP
.I /var/lib/ekf\-companion/checkpoint
State from which a restart of the service continues.
.TP
.I /opt/ekf\-companion/share/ekf\-companion/config/reference.yaml
Every key of the configuration, with unit, range and default.
.SH SEE ALSO
.BR systemctl (1),
.BR journalctl (1)
"""


def page() -> str:
    """Return the man page, in roff."""
    group = typer.main.get_command(app)
    root = group.make_context("ekf-companion", [], resilient_parsing=True)
    lines = [f'.TH EKF\\-COMPANION 1 "" "ekf\\-companion {__version__}"', ".SH NAME"]
    lines += ["ekf\\-companion \\- " + _roff(str(app.info.help)), ".SH SYNOPSIS", *_SYNOPSIS]
    lines += [".SH OPTIONS", *_parameters(group, root), ".SH COMMANDS"]
    for name in COMMANDS:
        lines += _command(name, group.get_command(root, name), root)  # type: ignore[attr-defined]
    return "\n".join(lines) + "\n" + _LAST


def _command(path: str, command: Any, parent: Any) -> Iterator[str]:
    """Yield the section of a command, and those of the commands below it."""
    context = type(parent)(command, info_name=path.split(" ")[-1], parent=parent)
    yield f".SS {_roff(path)}"
    yield _roff(" ".join(command.help.split()))
    below = getattr(command, "commands", {})
    if not below:
        yield ".PP"
        yield f".B ekf\\-companion {_roff(path)}"
        yield _roff(" ".join(command.collect_usage_pieces(context)))
        yield from _parameters(command, context)
    for name, one in below.items():
        yield from _command(f"{path} {name}", one, context)


def _parameters(command: Any, context: Any) -> Iterator[str]:
    for parameter in command.params:
        if (record := parameter.get_help_record(context)) is not None:
            yield ".TP"
            yield f".B {_roff(record[0])}"
            yield _roff(record[1])


def _roff(text: str) -> str:
    text = text.replace("\\", "\\e").replace("-", "\\-").replace("\u2026", "...")
    return "\\&" + text if text.startswith((".", "'")) else text


def completion(shell: str) -> str:
    """Return what a shell reads to complete the command."""
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM],
        env={**os.environ, "_EKF_COMPANION_COMPLETE": f"source_{shell}"},
        capture_output=True,
        text=True,
        check=True,
    )
    text = done.stdout.strip() + "\n"
    if shell == "zsh":
        # Read at the first Tab, it must complete as well
        head, _, _ = text.rpartition("compdef _ekf")
        text = head + '_ekf_companion_completion "$@"\n'
    return text


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    _write(MAN, page())
    for shell, path in COMPLETIONS.items():
        _write(path, completion(shell))

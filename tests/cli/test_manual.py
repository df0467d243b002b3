"""The man page and the completions that are installed, and -h."""

import shutil
import subprocess
import sys

import pytest
import typer
from typer.testing import CliRunner

from ekf_companion.cli import COMMANDS, app
from sim_autopilot.__main__ import app as sim
from tests.manual import COMPLETIONS, MAN, SHARE, completion

PROGRAM = """#!/bin/sh
exec {} -c "from ekf_companion.cli import app; app(prog_name='ekf-companion')" "$@"
"""


def commands(command, name=""):
    """Yield the name and the command of each that does something."""
    below = getattr(command, "commands", {})
    for word, one in below.items():
        yield from commands(one, f"{name} {word}")
    if not below:
        yield name, command


def all_commands():
    group = typer.main.get_command(app)
    context = group.make_context("ekf-companion", [], resilient_parsing=True)
    for name in COMMANDS:
        yield from commands(group.get_command(context, name), name)


def test_the_man_page_has_every_command_and_option():
    """`make reference` writes it."""
    sections = {
        head.replace("\\-", "-"): text.replace("\\-", "-")
        for head, _, text in (part.partition("\n") for part in MAN.read_text().split("\n.SS "))
    }
    for name, command in all_commands():
        for option in (word for one in command.params for word in one.opts if word[0] == "-"):
            if option not in ("--help", "-h"):
                assert option in sections[name], (name, option)
    assert len(sections) - 1 >= len(COMMANDS)


def test_the_man_page_is_well_formed():
    tool = shutil.which("groff")
    if tool is None:
        pytest.skip("groff is not installed")
    command = [tool, "-man", "-Tutf8", "-ww", "-z", MAN]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("shell", COMPLETIONS)
def test_a_completion_is_what_the_program_prints(shell):
    assert COMPLETIONS[shell].read_text().strip() == completion(shell).strip()


def test_bash_completes_commands_and_options(tmp_path):
    program = tmp_path / "ekf-companion"
    program.write_text(PROGRAM.format(sys.executable))
    program.chmod(0o755)
    script = (
        f"export PATH={tmp_path}:$PATH; . {COMPLETIONS['bash']}\n"
        'tab() { COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1))\n'
        "_ekf_companion_completion ekf-companion; echo ${COMPREPLY[*]}; }\n"
        "tab ekf-companion conv; tab ekf-companion calibrate ''; tab ekf-companion convert --sm\n"
    )
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["convert", "noise delay mag", "--smooth"]


def test_the_shells_own_checkers_find_no_fault():
    for shell, path in COMPLETIONS.items():
        if shutil.which(shell):
            subprocess.run([shell, "-n", path], check=True)
    assert {path for path in SHARE.rglob("*") if path.is_file()} == {MAN, *COMPLETIONS.values()}


@pytest.mark.parametrize("arguments", [[], ["convert"], ["calibrate"], ["calibrate", "noise"]])
def test_h_is_help(arguments):
    short, long = (CliRunner().invoke(app, [*arguments, word]) for word in ("-h", "--help"))
    assert short.exit_code == 0
    assert short.output == long.output
    assert CliRunner().invoke(sim, ["fly", "-h"]).exit_code == 0

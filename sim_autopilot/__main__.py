"""The commands of ``sim-autopilot``; the only place here that prints or exits.

Long argument lists are the options of a command.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import typer
from rich.console import Console
from rich.table import Column, Table

from ekf_companion.cli.command import Command, Group
from ekf_companion.errors import CompanionError
from ekf_companion.link.link import Link
from sim_autopilot import demo as demonstration
from sim_autopilot import replay as replaying
from sim_autopilot.config import load
from sim_autopilot.episodes import summaries
from sim_autopilot.faults.fault import KINDS, Number
from sim_autopilot.faults.fault import parse as parse_fault
from sim_autopilot.firmware import IDEAL, PERSONALITIES
from sim_autopilot.firmware import parse as parse_personality
from sim_autopilot.flight import Flight
from sim_autopilot.fly import Flown, over, play, run, telling
from sim_autopilot.fly import fly as fly_over
from sim_autopilot.lidar.beams import BEAMS
from sim_autopilot.lidar.device import Device
from sim_autopilot.lidar.livox import datagrams, write_pcap
from sim_autopilot.lidar.radar import RAYS, simulate_radar
from sim_autopilot.lidar.record import Simulated, usual_lidar
from sim_autopilot.lidar.record import simulate as simulate_lidar
from sim_autopilot.lidar.worlds import WORLDS
from sim_autopilot.lidar.write import write_bag, write_sequence
from sim_autopilot.loop import Bench, StreamRequester
from sim_autopilot.personality import Kind, Personality
from sim_autopilot.recording import TlogWriter, write_score, write_truth
from sim_autopilot.scenarios import SCENARIOS
from sim_autopilot.score_table import sentences, table

app = typer.Typer(
    name="sim-autopilot",
    cls=Group,
    help="A fake autopilot: flies, speaks MAVLink, and scores the estimate that comes back.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)
_console = Console()
_errors = Console(stderr=True)
_REQUESTED = {
    "HIGHRES_IMU": 250.0,
    "GPS_RAW_INT": 10.0,
    "ATTITUDE": 10.0,
    "GLOBAL_POSITION_INT": 5.0,
    "SCALED_PRESSURE": 10.0,
    "SYSTEM_TIME": 1.0,
    "EXTENDED_SYS_STATE": 1.0,
}
"""Streams that the companion requests, Hz."""

SCENARIO = typer.Option("figure-eight", help="Which motion; `scenarios` lists them.")
LINK = typer.Option(..., help="Where to: udpout:127.0.0.1:14540, udpin:, tcp:, tcpin:, serial:")
SEED = typer.Option(1, help="The same seed gives the same flight, bit by bit.", min=0)
DURATION = typer.Option(
    None, help="Seconds; as long as the scenario is, if not given.", min=0.1, max=1e5
)
SKIP = typer.Option(0.0, help="Begin so many seconds into the scenario.", min=0.0, max=1e5)
IMU_RATE = typer.Option(None, help="Inertial samples, Hz.", min=1.0, max=1000.0)
SPEED = typer.Option(1.0, help="How many times as fast as real time.", min=0.01, max=1000.0)
TRUTH = typer.Option(None, help="Write the true motion to this CSV file.")
CONFIG = typer.Option(None, help="YAML with what differs from the defaults.")
AUTOPILOT = typer.Option(Kind.PX4, help="Which autopilot to imitate, ideal: without its habits.")
PERSONALITY = typer.Option(
    None, help="Which autopilot to imitate, with its habits; `personalities` lists them."
)
WORLD = typer.Option("room", help=f"Where: {', '.join(WORLDS)}.")
BEAM = typer.Option(None, help="spin16, spin32, rosette or radar; None: as usual there.")
LIVOX_BEGIN_NS = 20_000_000_000
"""A Livox's clock when it begins to measure: it has been on for so long."""
FAULT = typer.Option(
    [], help="A failure: KIND[:start=20,duration=5,...]; `faults` lists them. Repeatable."
)


@app.command(cls=Command)
def fly(
    scenario: str = SCENARIO,
    link: str = LINK,
    seed: int = SEED,
    duration: float | None = DURATION,
    skip: float = SKIP,
    imu_rate: float | None = IMU_RATE,
    speed: float = SPEED,
    truth: Path | None = TRUTH,
    log: Path | None = typer.Option(None, help="Record every frame out and in to this .tlog."),
    score: Path | None = typer.Option(None, help="Write the score to this JSON file."),
    score_after: float = typer.Option(10.0, help="Score from so many seconds on.", min=0.0),
    wait: float = typer.Option(0.0, help="Wait so many seconds for an answer first.", min=0.0),
    config: Path | None = CONFIG,
    autopilot: Kind = AUTOPILOT,
    personality: str | None = PERSONALITY,
    fault: list[str] = FAULT,
) -> None:
    """Fly a scenario over a link, in real time, and score the ODOMETRY that comes back."""
    with _exit_on_error(), ExitStack() as stack:
        imitated = IDEAL[autopilot] if personality is None else parse_personality(personality)
        flight = _plan(scenario, config, imu_rate, seed, duration, skip, imitated)
        faults = [parse_fault(text, flight.duration) for text in fault]
        if truth is not None:
            write_truth(truth, flight)
        writer = None
        if log is not None:
            writer = stack.enter_context(TlogWriter(log, flight.config.home.unix))
        body = partial(
            fly_over, flight, personality=imitated, faults=faults, speed=speed, wait=wait
        )

        async def told(link: Link) -> Flown:
            async with telling(flight.duration / speed, _tell):
                return await body(link, log=writer)

        flown = run(over(link, told))
        result = flown.witness.score(score_after)
        result["autopilot"] = {
            "personality": imitated.name if personality else f"ideal {imitated.name}",
            **flown.autopilot.reception.summary(),
        }
        result["faults"] = summaries(flown.witness, flight, faults)
        if score is not None:
            write_score(score, result)
    _report(result, {})


@app.command(cls=Command)
def generate(
    scenario: str = SCENARIO,
    output: Path = typer.Option(..., "--output", "-o", help="The .tlog to write."),
    truth: Path | None = TRUTH,
    seed: int = SEED,
    duration: float | None = DURATION,
    skip: float = SKIP,
    imu_rate: float | None = IMU_RATE,
    config: Path | None = CONFIG,
    autopilot: Kind = AUTOPILOT,
    personality: str | None = PERSONALITY,
    fault: list[str] = FAULT,
) -> None:
    """Write a scenario to a .tlog at once, without a link: the same frames that `fly` sends.

    With a personality, the messages that the companion needs are requested.
    """
    with _exit_on_error():
        if output.suffix != ".tlog":
            raise typer.BadParameter(f"{output}: unknown kind of output; name it .tlog")
        imitated = IDEAL[autopilot] if personality is None else parse_personality(personality)
        flight = _plan(scenario, config, imu_rate, seed, duration, skip, imitated)
        faults = [parse_fault(text, flight.duration) for text in fault]
        if truth is not None:
            write_truth(truth, flight)
        peer = None if personality is None else StreamRequester(_REQUESTED)
        bench = Bench(flight, peer, personality=imitated, faults=faults)
        count = 0
        with TlogWriter(output, flight.config.home.unix) as writer:
            for t_ns, frame in bench.frames():
                writer.write(t_ns, frame)
                count += 1
    _console.print(f"{output}: {count} messages, {flight.duration:.1f} s of {scenario}")


@app.command(cls=Command)
def replay(
    log: Path = typer.Argument(..., help="A .tlog, .bin, .ulg or .csv."),
    link: str = LINK,
    speed: float = SPEED,
) -> None:
    """Send a recorded flight as a live stream."""
    with _exit_on_error():
        count = run(over(link, lambda opened: play(replaying.frames(log), opened, speed)))
    _console.print(f"{log}: {count} messages sent")


@app.command(cls=Command)
def lidar(
    output: Path = typer.Argument(
        ...,
        help="A folder for .npz arrays, a .bag of ROS 1, .mcap or .db3: a folder of ROS 2; .pcap: "
        "what a Livox sends.",
    ),
    world: str = WORLD,
    beams: str | None = BEAM,
    seed: int = SEED,
    duration: float = typer.Option(40.0, help="Seconds.", min=2.0, max=600.0),
) -> None:
    """Write a recording of a simulated lidar and inertial sensor, with its truth."""
    with _exit_on_error():
        if beams == RAYS.name and output.suffix == ".pcap":
            raise typer.BadParameter("a Livox is no radar; write a folder, a .bag, .mcap or .db3")
        recorded = _lidar(world, beams, seed, duration, output.stem)
        if output.suffix in (".bag", ".mcap", ".db3"):
            write_bag(output, recorded)
        elif output.suffix == ".pcap":
            write_pcap(output, datagrams(recorded, LIVOX_BEGIN_NS))
        else:
            write_sequence(output, recorded)
    _console.print(
        f"{output}: {len(recorded.stamp)} scans, {len(recorded.xyz)} points, "
        f"{len(recorded.imu_stamp)} inertial samples, {duration:.1f} s of {world}"
    )


@app.command(cls=Command)
def livox(
    host: str = typer.Argument(..., help="Its address, one of this computer's: 127.0.0.2"),
    port: int = typer.Option(56100, help="Of its commands.", min=1, max=65535),
    world: str = WORLD,
    beams: str | None = BEAM,
    seed: int = SEED,
    duration: float = typer.Option(40.0, help="Seconds.", min=2.0, max=600.0),
) -> None:
    """Be a Livox Mid-360 on the network: send once told to, in real time, to the end."""
    with _exit_on_error():
        if beams == RAYS.name:
            raise typer.BadParameter("a Livox is no radar")
        recorded = _lidar(world, beams, seed, duration, "livox")
        with Device(recorded, host, port=port, begin_ns=LIVOX_BEGIN_NS) as device:
            _console.print(f"{host} port {device.command_port}: waiting to be told to send")
            device.is_done.wait()
    _console.print(f"{device.sent} datagrams sent, {duration:.1f} s of {world}")


def _lidar(world: str, beams: str | None, seed: int, duration: float, name: str) -> Simulated:
    for given, known in ((world, [*WORLDS]), (beams, [*BEAMS, RAYS.name])):
        if given is not None and given not in known:
            raise typer.BadParameter(f"{given}: unknown; there are {', '.join(known)}")
    if beams == RAYS.name:
        return simulate_radar(world, seed, duration=duration)
    fitted = usual_lidar(world, BEAMS[beams] if beams else None)
    return simulate_lidar(world, seed, duration=duration, lidar=fitted, name=name)


@app.command(cls=Command)
def scenarios() -> None:
    """List the motions that can be flown."""
    listing = Table(
        "scenario", Column("seconds", justify="right"), "what", box=None, pad_edge=False
    )
    for scenario in SCENARIOS.values():
        listing.add_row(scenario.name, f"{scenario.duration:.0f}", scenario.summary)
    _console.print(listing)


@app.command(cls=Command)
def personalities() -> None:
    """List the autopilots that can be imitated."""
    listing = Table("personality", "what", box=None, pad_edge=False)
    for one in PERSONALITIES.values():
        listing.add_row(one.name, one.summary)
    _console.print(listing)
    _console.print(
        "\nNAME:key=value,... changes a number (loop_rate=50, gcs_rate=4, link_rate=5760, "
        "missing=0.1) or, in capitals, a parameter (EKF2_AID_MASK=9).",
        highlight=False,
    )


@app.command(cls=Command)
def faults() -> None:
    """List the faults, and the values of each."""
    listing = Table(
        "fault", Column("seconds", justify="right"), "values", "what", box=None, pad_edge=False
    )
    for kind in KINDS.values():
        values = [
            f"{key}={value.default:g}" if isinstance(value, Number) else f"{key}={value}"
            for key, value in kind.values.items()
        ]
        listing.add_row(kind.name, f"{kind.duration:.0f}", "\n".join(values), kind.summary)
    _console.print(listing)
    _console.print("\nEvery fault takes start=0 and duration=seconds too.", highlight=False)


@app.command(cls=Command)
def demo(
    out: Path = typer.Option(Path("demo"), help="Folder for demo.png, score.json and truth.csv."),
    duration: float = typer.Option(60.0, help="Seconds.", min=12.0, max=1e5),
    seed: int = SEED,
    daemon_config: Path | None = typer.Option(None, help="YAML file for the daemon."),
) -> None:
    """Fly figure-eight against the real daemon over UDP, and compare the errors with limits."""
    with _exit_on_error():
        score, files = demonstration.fly(
            out,
            duration=duration,
            seed=seed,
            daemon_config=daemon_config,
            on_progress=_tell,
        )
    _report(score, demonstration.LIMITS)
    for file in files:
        _console.print(f"{file}")
    complaints = demonstration.complaints(score, out / "daemon.log")
    for complaint in complaints:
        _errors.print(f"[bold red]{complaint}[/]")
    if complaints:
        raise typer.Exit(1)


def _tell(words: str) -> None:
    """Print a line of progress."""
    _errors.print(words, highlight=False)


def _plan(
    scenario: str,
    config: Path | None,
    imu_rate: float | None,
    seed: int,
    duration: float | None,
    skip: float,
    personality: Personality,
) -> Flight:
    if scenario not in SCENARIOS:
        known = ", ".join(SCENARIOS)
        raise typer.BadParameter(f"{scenario!r}: no such scenario; there are {known}")
    numbers = personality.suited(load(config))
    if imu_rate is not None:
        imu = dataclasses.replace(numbers.imu, rate=imu_rate)
        numbers = dataclasses.replace(numbers, imu=imu)
    return Flight.plan(scenario, numbers, seed=seed, duration=duration, skip=skip)


def _report(score: dict[str, Any], limits: dict[str, float]) -> None:
    if score["odometry"]["scored"]:
        _console.print(table(score, limits))
    for sentence in sentences(score):
        _console.print(sentence, highlight=False)


@contextmanager
def _exit_on_error() -> Iterator[None]:
    """Print an error as a sentence, and exit with 2."""
    try:
        yield
    except (CompanionError, OSError) as error:
        sentence = str(error)
        if isinstance(error, OSError) and error.filename is not None:
            sentence = f"{error.filename}: {error.strerror}"
        _errors.print(sentence, style="bold red", highlight=False, markup=False)
        raise typer.Exit(2) from error


if __name__ == "__main__":
    app()

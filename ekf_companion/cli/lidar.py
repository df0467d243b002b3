"""Estimate the way of a lidar or a radar from its scans and inertial samples."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from ekf_companion.cli import terminal
from ekf_companion.cli.progress import progress_line
from ekf_companion.errors import ConfigError, LogError, require

if TYPE_CHECKING:
    from ekf_companion.lidar.recording import Mounting, Recording
    from ekf_companion.lidar.settings import Settings
    from ekf_companion.lidar.solution import Solution

FORMS = (".tum", ".csv", ".mcap")
FILTERS: dict[str, dict[str, Any]] = {
    "anchors": {},
    "fast-lio": {"anchors": 0},
    "lins": {"is_scan_to_scan": True},
    "doppler": {},
}
"""Settings of each filter."""
LEAST_ANGLE, LEAST_SHIFT = 3.0, 0.05
"""Sigma of a mounting that is to be found, deg and m: measured by eye and by tape."""
LATE = 0.02
"""Sigma of a delay that is to be found, s: two or three inertial samples of an autopilot."""


def lidar(
    recording: Annotated[
        Path,
        typer.Argument(help="Bag, .mcap, .pcap, folder of clouds with imu.csv, or of .npz."),
    ],
    outs: Annotated[
        list[Path] | None,
        typer.Option(
            "--out", "-o", help=".tum, .csv with sigmas, or .mcap; may be given several times."
        ),
    ] = None,
    rel: Annotated[
        Path | None, typer.Option(help="Relative poses with their covariance, as .csv.")
    ] = None,
    cov: Annotated[
        Path | None, typer.Option(help="Covariance of each pose since the first, as .csv.")
    ] = None,
    cloud: Annotated[Path | None, typer.Option("--map", help="Points of the map, as .ply.")] = None,
    report: Annotated[
        Path | None,
        typer.Option(help="Track, map, sigmas, holds and innovations, as .html."),
    ] = None,
    lidar_pose: Annotated[
        str | None,
        typer.Option(
            help="X,Y,Z,ROLL,PITCH,YAW of lidar or radar on the inertial sensor, m and deg; "
            "forward, left, up. Default: as the recording says."
        ),
    ] = None,
    find: Annotated[
        list[str] | None,
        typer.Option(help="mounting or delay: estimate it too; may be given several times."),
    ] = None,
    velocity: Annotated[
        Path | None, typer.Option(help="Velocities by the scans of a radar alone, as .csv.")
    ] = None,
    form: Annotated[
        str | None,
        typer.Option(
            "--filter",
            help="anchors; lins: scan to last scan; fast-lio: the map is taken as known; doppler: "
            "by radial speeds, where points have them.",
        ),
    ] = None,
    most_speed: Annotated[
        float,
        typer.Option(min=0.0, help="Radial speed at which those of a radar wrap, m/s; 0: never."),
    ] = 0.0,
    nearest: Annotated[float, typer.Option(min=0.0, help="Leave out nearer points, m.")] = 0.5,
    farthest: Annotated[float, typer.Option(min=1.0, help="Leave out farther points, m.")] = 80.0,
    stamp: Annotated[
        str | None, typer.Option(help="start, middle or end of a scan: of which its stamp is.")
    ] = None,
    lidar_topic: Annotated[str | None, typer.Option(help="Of the scans in a bag.")] = None,
    imu_topic: Annotated[str | None, typer.Option(help="Of the inertial samples in a bag.")] = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Estimate the way of a lidar or a radar, with covariance, from scans and inertial samples."""
    from ekf_companion.lidar.readers import read
    from ekf_companion.lidar.solution import solve

    with terminal.exit_on_error():
        outputs = [Output("--out", out, out.suffix) for out in outs or []]
        named = (
            Output("--rel", rel, "rel"),
            Output("--cov", cov, "cov"),
            Output("--map", cloud, "ply"),
            Output("--report", report, ".html"),
            Output("--velocity", velocity, "velocity"),
        )
        outputs += [one for one in named if one.path is not None]
        _check_outputs(recording, outputs)
        settings = _settings(find or [], form, nearest, farthest, most_speed)
        if stamp not in (None, "start", "middle", "end"):
            raise ConfigError(f"--stamp: {stamp}: is start, middle or end")
        pose = None if lidar_pose is None else read_mounting("--lidar-pose", lidar_pose)

        with progress_line(recording.name):
            found = read(
                recording,
                mounting=pose,
                stamp=stamp,
                lidar=lidar_topic,
                imu=imu_topic,
                by_doppler=None if form is None else form == "doppler",
                most_speed=most_speed,
            )
            _check_kind(found, outputs, stamp)
            solution = solve(_unsure(found) if settings.is_mounting_estimated else found, settings)
        if not len(solution.track):
            raise LogError(f"{recording}: holds no scan to estimate from")
        _write(solution, found, settings, outputs)
    verdict, remarks = solution.verdict(), solution.remarks()
    data = {
        "recording": str(recording),
        "verdict": verdict,
        "way_m": solution.way,
        "sigma_m": solution.sigma,
        "without_hold": [
            {"start": one.start, "end": one.end, "direction": one.direction}
            for one in solution.open_stretches()
        ],
        "remarks": remarks,
    }
    terminal.show(as_json, data, [verdict, *remarks])
    for one in outputs:
        typer.echo(f"wrote {one.path}", err=as_json)


class Output(NamedTuple):
    """A file that is asked for."""

    option: str
    path: Path | None
    kind: str
    """How its suffix, or else its option, says what it holds."""


def _check_outputs(recording: Path, outputs: list[Output]) -> None:
    """Refuse before the work what cannot be written after it."""
    paths = [(one.option, one.path) for one in outputs if one.path is not None]
    terminal.check_outputs({"the recording": recording}, paths)
    for option, path, kind in outputs:
        if option == "--out" and kind not in FORMS:
            raise ConfigError(f"--out: {path}: is a .tum, .csv or .mcap; name one of them")
        if kind == ".mcap":
            require("formats", "an .mcap", "mcap.writer")
        if option == "--report" and path is not None:
            if path.suffix.lower() not in (".html", ".htm"):
                raise ConfigError(f"--report: {path}: is a .html")
            require("report", "--report", "bokeh")


def _check_kind(recording: Recording, outputs: list[Output], stamp: str | None) -> None:
    """Refuse what a lidar or a radar has not."""
    asked = {one.option for one in outputs}
    if recording.by_doppler and "--map" in asked:
        raise ConfigError("--map: a radar's way is found by its speeds, without a map")
    if recording.by_doppler and stamp is not None:
        raise ConfigError("--stamp: is of a lidar; how late a radar is `--find delay` finds")
    if not recording.by_doppler and "--velocity" in asked:
        raise ConfigError("--velocity: is of a radar, whose points have radial speeds")


def _settings(
    find: list[str], form: str | None, nearest: float, farthest: float, most_speed: float
) -> Settings:
    """Return the settings that the options say."""
    from ekf_companion.lidar.settings import Settings

    if wrong := set(find) - {"mounting", "delay"}:
        raise ConfigError(f"--find: {wrong.pop()}: is mounting or delay")
    if form is not None and form not in FILTERS:
        raise ConfigError(f"--filter: {form}: is anchors, lins, fast-lio or doppler")
    if nearest >= farthest:
        raise ConfigError("--nearest: is beyond --farthest")
    return Settings(
        least_range=nearest,
        most_range=farthest,
        is_mounting_estimated="mounting" in find,
        delay_sigma=LATE if "delay" in find else 0.0,
        most_doppler=most_speed,
        **FILTERS[form or "anchors"],
    )


def _unsure(recording: Recording) -> Recording:
    """Return a recording whose mounting was measured by eye and by tape."""
    from dataclasses import replace

    import numpy as np

    mounting = replace(
        recording.mounting,
        rotation_sigma=max(recording.mounting.rotation_sigma, np.radians(LEAST_ANGLE)),
        position_sigma=max(recording.mounting.position_sigma, LEAST_SHIFT),
    )
    return replace(recording, mounting=mounting)


def _write(
    solution: Solution, recording: Recording, settings: Settings, outputs: list[Output]
) -> None:
    """Write what is asked for."""
    from ekf_companion.analysis import lidar_mcap, lidar_report
    from ekf_companion.lidar import doppler
    from ekf_companion.lidar.solution import lines_of
    from ekf_companion.logs.writer import create

    for _, path, kind in outputs:
        assert path is not None
        if kind == ".html":
            lidar_report.write(path, solution)
            continue
        with create(path) as file:
            if kind == ".mcap":
                lidar_mcap.write(solution, file)
                continue
            lines = lines_of(solution, kind)
            if kind == "velocity":
                lines = doppler.lines_of(doppler.velocities(recording.scans, settings))
            for line in lines:
                file.write(f"{line}\n".encode())


def read_mounting(option: str, text: str) -> Mounting:
    """Return the mounting that an option says.

    Raises:
        ConfigError: It is not six numbers.
    """
    import numpy as np

    from ekf_companion.lidar.recording import Mounting
    from ekf_companion.nav import so3

    try:
        numbers = [float(one) for one in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 6 or not np.isfinite(numbers).all():
        raise ConfigError(f"{option}: {text}: is six numbers, X,Y,Z,ROLL,PITCH,YAW in m and deg")
    roll, pitch, yaw = np.radians(numbers[3:]).tolist()
    C = so3.to_matrix(so3.from_euler(roll, pitch, yaw))
    return Mounting(C, np.array(numbers[:3]))

"""Estimate the way of a lidar from its scans and inertial samples."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ekf_companion.cli import terminal
from ekf_companion.cli.progress import progress_line
from ekf_companion.errors import ConfigError, LogError, require

if TYPE_CHECKING:
    from ekf_companion.lidar.recording import Mounting

FORMS = (".tum", ".csv", ".mcap")
FILTERS: dict[str, dict[str, Any]] = {
    "anchors": {},
    "fast-lio": {"anchors": 0},
    "lins": {"is_scan_to_scan": True},
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
            help="X,Y,Z,ROLL,PITCH,YAW of the lidar on the inertial sensor, m and deg; forward, "
            "left, up. Default: as the recording says."
        ),
    ] = None,
    find: Annotated[
        list[str] | None,
        typer.Option(help="mounting or delay: estimate it too; may be given several times."),
    ] = None,
    form: Annotated[
        str,
        typer.Option(
            "--filter",
            help="anchors; lins: scan to last scan; fast-lio: the map is taken as known.",
        ),
    ] = "anchors",
    nearest: Annotated[float, typer.Option(min=0.0, help="Leave out nearer points, m.")] = 0.5,
    farthest: Annotated[float, typer.Option(min=1.0, help="Leave out farther points, m.")] = 80.0,
    stamp: Annotated[
        str | None, typer.Option(help="start, middle or end of a scan: of which its stamp is.")
    ] = None,
    lidar_topic: Annotated[str | None, typer.Option(help="Of the scans in a bag.")] = None,
    imu_topic: Annotated[str | None, typer.Option(help="Of the inertial samples in a bag.")] = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Estimate a lidar's way with an honest covariance, from its scans and inertial samples."""
    from dataclasses import replace

    import numpy as np

    from ekf_companion.analysis import lidar_mcap, lidar_report
    from ekf_companion.lidar.readers import read
    from ekf_companion.lidar.settings import Settings
    from ekf_companion.lidar.solution import lines_of, solve
    from ekf_companion.logs.writer import create

    with terminal.exit_on_error():
        outputs = [("--out", out) for out in outs or []]
        named = (("--rel", rel), ("--cov", cov), ("--map", cloud), ("--report", report))
        outputs += [(name, path) for name, path in named if path is not None]
        terminal.check_outputs({"the recording": recording}, list(outputs))
        for out in outs or []:
            if out.suffix not in FORMS:
                raise ConfigError(f"--out: {out}: is a .tum, .csv or .mcap; name one of them")
            if out.suffix == ".mcap":
                require("formats", "an .mcap", "mcap.writer")
        if wrong := set(find or []) - {"mounting", "delay"}:
            raise ConfigError(f"--find: {wrong.pop()}: is mounting or delay")
        if report is not None:
            if report.suffix.lower() not in (".html", ".htm"):
                raise ConfigError(f"--report: {report}: is a .html")
            require("report", "--report", "bokeh")
        if form not in FILTERS:
            raise ConfigError(f"--filter: {form}: is anchors, lins or fast-lio")
        if stamp not in (None, "start", "middle", "end"):
            raise ConfigError(f"--stamp: {stamp}: is start, middle or end")
        if nearest >= farthest:
            raise ConfigError("--nearest: is beyond --farthest")
        pose = None if lidar_pose is None else _mounting(lidar_pose)

        with progress_line(recording.name):
            found = read(recording, mounting=pose, stamp=stamp, lidar=lidar_topic, imu=imu_topic)
            if "mounting" in (find or []):
                wide = replace(
                    found.mounting,
                    rotation_sigma=max(found.mounting.rotation_sigma, np.radians(LEAST_ANGLE)),
                    position_sigma=max(found.mounting.position_sigma, LEAST_SHIFT),
                )
                found = replace(found, mounting=wide)
            settings = Settings(
                least_range=nearest,
                most_range=farthest,
                is_mounting_estimated="mounting" in (find or []),
                delay_sigma=LATE if "delay" in (find or []) else 0.0,
                **FILTERS[form],
            )
            solution = solve(found, settings)
        if not solution.estimates:
            raise LogError(f"{recording}: holds no scan to estimate from")
        kinds = [(out, out.suffix) for out in outs or []]
        kinds += [(path, kind) for path, kind in ((rel, "rel"), (cov, "cov")) if path is not None]
        kinds += [(cloud, "ply")] if cloud is not None else []
        for path, kind in kinds:
            with create(path) as file:
                if kind == ".mcap":
                    lidar_mcap.write(solution, file)
                    continue
                for line in lines_of(solution, kind):
                    file.write(f"{line}\n".encode())
        if report is not None:
            lidar_report.write(report, solution)
            kinds.append((report, ".html"))
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
    for path, _ in kinds:
        typer.echo(f"wrote {path}", err=as_json)


def _mounting(text: str) -> Mounting:
    """Return the mounting that an option says."""
    import numpy as np

    from ekf_companion.lidar.recording import Mounting
    from ekf_companion.nav import so3

    try:
        numbers = [float(one) for one in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 6 or not np.isfinite(numbers).all():
        raise ConfigError(
            f"--lidar-pose: {text}: is six numbers, X,Y,Z,ROLL,PITCH,YAW in m and deg"
        )
    roll, pitch, yaw = np.radians(numbers[3:]).tolist()
    C = so3.to_matrix(so3.from_euler(roll, pitch, yaw))
    return Mounting(C, np.array(numbers[:3]))

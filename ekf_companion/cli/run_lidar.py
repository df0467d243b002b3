"""Run a lidar's odometry beside the daemon."""

from __future__ import annotations

import logging
from ipaddress import IPv4Address
from typing import TYPE_CHECKING, Annotated

import typer

from ekf_companion.cli.lidar import read_mounting
from ekf_companion.cli.terminal import exit_on_error
from ekf_companion.errors import ConfigError

if TYPE_CHECKING:
    from ekf_companion.link.ros2 import Network


def run_lidar(
    lidar: Annotated[
        str,
        typer.Argument(
            help="Address of a Livox Mid-360, 192.168.1.1XX, XX the end of its number; or the "
            "topic of a lidar's PointCloud2 in ROS 2, as in /points."
        ),
    ],
    to: Annotated[
        str, typer.Option(help="Where the daemon listens for poses: HOST:PORT of link.aid_url.")
    ] = "127.0.0.1:14560",
    ports: Annotated[
        str, typer.Option(help="Ports here: of points, inertial samples, commands.")
    ] = "56301,56401,56101",
    listen: Annotated[str, typer.Option(help="Address here.")] = "0.0.0.0",
    on_vehicle: Annotated[
        str,
        typer.Option(help="ROLL,PITCH,YAW of the lidar on the vehicle, deg; forward, left, up."),
    ] = "0,0,0",
    lidar_pose: Annotated[
        str | None,
        typer.Option(
            help="X,Y,Z,ROLL,PITCH,YAW of the lidar on its inertial sensor, m and deg. Default: as "
            "in a Mid-360; of ROS 2: at the same place, axes alike."
        ),
    ] = None,
    imu: Annotated[
        str, typer.Option(help="Of ROS 2: topic of the inertial samples (sensor_msgs/Imu).")
    ] = "/imu",
    connect: Annotated[
        str, typer.Option(help="Of ROS 2: endpoints of zenoh to connect to.")
    ] = "tcp/127.0.0.1:7447",
    zenoh_listen: Annotated[
        str, typer.Option(help="Of ROS 2: endpoints of zenoh at which others may connect.")
    ] = "tcp/127.0.0.1:0",
    domain: Annotated[int, typer.Option(min=0, max=232, help="ROS_DOMAIN_ID.")] = 0,
    configure: Annotated[
        bool, typer.Option(help="Tell the lidar to sample and to send here.")
    ] = True,
    nearest: Annotated[float, typer.Option(min=0.0, help="Leave out nearer points, m.")] = 0.5,
    farthest: Annotated[float, typer.Option(min=1.0, help="Leave out farther points, m.")] = 70.0,
    system_id: Annotated[int, typer.Option(min=1, max=255, help="Of its ODOMETRY.")] = 240,
    log_level: Annotated[str, typer.Option(help="DEBUG, INFO, WARNING or ERROR.")] = "INFO",
) -> None:
    """Run a lidar's odometry until SIGTERM, and send it to the daemon on this board."""
    from ekf_companion.daemon import lidar as service
    from ekf_companion.daemon import logging as journal
    from ekf_companion.lidar.livox import MID_360
    from ekf_companion.lidar.livox_command import COMMAND_PORT
    from ekf_companion.lidar.recording import Mounting
    from ekf_companion.lidar.settings import Settings

    with exit_on_error():
        level = read_level(log_level)
        if nearest >= farthest:
            raise ConfigError("--nearest: is beyond --farthest")
        is_topic = lidar.startswith("/")
        host, command_port = (
            (lidar, COMMAND_PORT) if is_topic else read_address("LIDAR", lidar, COMMAND_PORT)
        )
        aid_host, aid_port = read_address("--to", to, None)
        point_port, imu_port, host_port = _ports(ports)
        if on_vehicle.count(",") != 2:
            raise ConfigError(f"--on-vehicle: {on_vehicle!r:.60}: is ROLL,PITCH,YAW in deg")
        turned = read_mounting("--on-vehicle", f"0,0,0,{on_vehicle}")
        mounting = Mounting() if is_topic else MID_360
        if lidar_pose is not None:
            mounting = read_mounting("--lidar-pose", lidar_pose)
        options = service.LidarOptions(
            lidar=host,
            command_port=command_port,
            listen=read_address("--listen", listen, 0)[0],
            point_port=point_port,
            imu_port=imu_port,
            host_port=host_port,
            is_configured=configure,
            imu_topic=imu,
            network=network_of(connect, zenoh_listen, domain),
            aid_host=aid_host,
            aid_port=aid_port,
            system_id=system_id,
            mounting=mounting,
            on_vehicle=turned.rotation,
            settings=Settings(least_range=nearest, most_range=farthest),
        )
        journal.set_up(level)
        service.run(options)


def network_of(connect: str, listen: str, domain: int) -> Network:
    """Return the zenoh network that options name."""
    from ekf_companion.link.ros2 import Network

    there, here = (tuple(filter(None, text.split(","))) for text in (connect, listen))
    return Network(there, here, domain)


def read_level(text: str) -> int:
    """Return the number of a log level.

    Raises:
        ConfigError: It is none.
    """
    level = logging.getLevelName(text.upper())
    if not isinstance(level, int):
        raise ConfigError(f"--log-level: {text!r}: use DEBUG, INFO, WARNING or ERROR")
    return level


def read_address(name: str, text: str, default: int | None) -> tuple[str, int]:
    """Return a numeric address and a port.

    Raises:
        ConfigError: It is none.
    """
    host, colon, port = text.partition(":")
    try:
        IPv4Address(host)
    except ValueError:
        raise ConfigError(
            f"{name}: {text!r:.60}: is no numeric address, as in 192.168.1.150"
        ) from None
    if not colon and default is not None:
        return host, default
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise ConfigError(f"{name}: {text!r:.60}: is no HOST:PORT, as in 127.0.0.1:14560")
    return host, int(port)


def _ports(text: str) -> tuple[int, int, int]:
    words = text.split(",")
    numbers = [int(word) for word in words if word.isdecimal() and 0 < int(word) < 65536]
    if len(words) != 3 or len({*numbers}) != 3:
        raise ConfigError(f"--ports: {text!r:.60}: is three ports, as in 56301,56401,56101")
    points, samples, commands = numbers
    return points, samples, commands

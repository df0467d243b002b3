"""Run the process between the daemon and ROS 2."""

from __future__ import annotations

from typing import Annotated

import typer

from ekf_companion.cli.run_lidar import network_of, read_address, read_level
from ekf_companion.cli.terminal import exit_on_error
from ekf_companion.errors import ConfigError


def run_ros2(
    odometry: Annotated[
        str | None,
        typer.Option(help="Topic of the nav_msgs/Odometry that the daemon is to use: /vio/odom."),
    ] = None,
    estimate: Annotated[
        str | None,
        typer.Option(help="Topic of the daemon's estimates as nav_msgs/Odometry: /ekf/odom."),
    ] = None,
    connect: Annotated[
        str, typer.Option(help="Endpoints of zenoh to connect to: a router, bridge or peer.")
    ] = "tcp/127.0.0.1:7447",
    zenoh_listen: Annotated[
        str, typer.Option(help="Endpoints of zenoh at which others may connect.")
    ] = "tcp/127.0.0.1:0",
    domain: Annotated[int, typer.Option(min=0, max=232, help="ROS_DOMAIN_ID.")] = 0,
    to: Annotated[
        str, typer.Option(help="Where the daemon listens for poses: HOST:PORT of link.aid_url.")
    ] = "127.0.0.1:14560",
    estimate_port: Annotated[
        int,
        typer.Option(min=1, max=65535, help="PORT of udpout:127.0.0.1:PORT in output.monitors."),
    ] = 14561,
    frame: Annotated[str, typer.Option(help="Frame of the estimates' poses.")] = "odom",
    body: Annotated[str, typer.Option(help="Frame of the estimates' body.")] = "base_link",
    system_id: Annotated[int, typer.Option(min=1, max=255, help="Of the poses.")] = 240,
    log_level: Annotated[str, typer.Option(help="DEBUG, INFO, WARNING or ERROR.")] = "INFO",
) -> None:
    """Pass odometry of ROS 2 to the daemon on this board until SIGTERM, and its estimates back."""
    from ekf_companion.daemon import logging as journal
    from ekf_companion.daemon import ros2 as service

    with exit_on_error():
        level = read_level(log_level)
        if odometry is None and estimate is None:
            raise ConfigError("--odometry, --estimate: give one of them, or both")
        if odometry is not None and odometry == estimate:
            raise ConfigError(
                f"--estimate: {estimate}: the daemon would be given its own estimates"
            )
        host, port = read_address("--to", to, None)
        journal.set_up(level)
        service.run(
            service.Ros2Options(
                odometry=odometry,
                estimate=estimate,
                network=network_of(connect, zenoh_listen, domain),
                aid_host=host,
                aid_port=port,
                estimate_port=estimate_port,
                system_id=system_id,
                frame=frame,
                body=body,
            )
        )

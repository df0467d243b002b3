"""Sections of the configuration that are the service's: who we are, what we send, what we keep."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from msgspec import Meta

Identifier = Annotated[int, Meta(ge=1, le=255)]
Rate = Annotated[float, Meta(gt=0.0, le=1000.0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkConfig:
    """How to reach the autopilot, and who we are on that link."""

    url: str = "udpin:0.0.0.0:14540"
    """``udpin:HOST:PORT``, ``udpout:``, ``tcp:``, ``tcpin:``, ``serial:/dev/ttyX:BAUD``."""
    component_id: Identifier = 194
    """Ours: MAV_COMP_ID_ONBOARD_COMPUTER4."""
    system_id: Identifier | None = None
    """Ours; null: the autopilot's."""
    autopilot: Identifier | None = None
    """System id of the one autopilot to listen to; null: the first that is heard, PX4
    and ArduPilot before any other."""
    imu_rate: Rate = 250.0
    """Inertial samples to ask for, Hz."""
    gnss_rate: Rate = 10.0
    """GNSS messages to ask for, Hz: twice the receiver's rate halves their wait for a turn."""
    heading_rate: Rate = 10.0
    """ATTITUDE messages to ask for, Hz."""
    baro_rate: Rate = 10.0
    """SCALED_PRESSURE messages to ask for, Hz."""
    peer: str = ""
    """HOST or HOST:PORT that UDP datagrams must come from; empty: whoever first sends a valid
    frame, until silent for 5 s."""
    allow_systems: tuple[Identifier, ...] = ()
    """System ids that may speak; empty: all."""
    allow_components: tuple[Identifier, ...] = ()
    """Component ids that may speak; empty: all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SigningConfig:
    """MAVLink 2 signing."""

    key_file: str = ""
    """File of mode 0600 that holds the secret: 32 bytes, or 64 hexadecimal digits. Empty: nothing
    is signed."""
    accept_unsigned: bool = False
    """Whether, with a key, frames without a signature are believed too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TimesyncConfig:
    """How our clock is compared with the autopilot's."""

    request: bool = True
    """Whether we ask."""
    respond: bool = True
    """Whether the autopilot's requests are answered: in its own time, once locked."""
    largest_rtt: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.01
    """An answer that took longer says too little, s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryConfig:
    """The estimate, streamed back."""

    mode: Literal["auto", "always", "never"] = "auto"
    """auto: unless the autopilot would fuse it together with the GNSS that is in it already."""
    independent: bool = False
    """Whether our GNSS and inertial sensor are our own, not the autopilot's: nothing is then
    counted twice, and auto always streams."""
    rate: Annotated[float, Meta(ge=1.0, le=1000.0)] = 30.0
    """Hz; never more than one per inertial sample, nor than 50 to ArduPilot."""
    frame: Literal["LOCAL_FRD", "LOCAL_NED"] = "LOCAL_FRD"
    """Frame of the pose. ArduPilot takes LOCAL_FRD only; the numbers are the same in both."""
    estimator_type: Literal["auto", "GPS_INS", "VIO"] = "auto"
    """auto: GPS_INS, which is true, but VIO towards PX4, which refuses the true one aloud."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputConfig:
    """What is streamed back."""

    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    monitors: tuple[str, ...] = ()
    """Listeners that are no autopilot, ``udpout:HOST:PORT`` or ``udpbcast:HOST:PORT``: each is sent
    our heartbeat and, whatever ``odometry.mode`` and the guard say, the estimate."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ParametersConfig:
    """Our own parameters, as a ground station sees them."""

    serve: bool = True
    """Whether they can be read and set over MAVLink."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordConfig:
    """What is kept."""

    path: str | None = None
    """A .tlog of every byte in and out, and of the estimate; null: none. ``%s`` in the name becomes
    the time of start. A file that is there stays as it is: the new one gets a number behind its
    name."""
    file_size: Annotated[float, Meta(ge=1.0, le=1e7)] = 256.0
    """A new file is begun at so many MB."""
    total_size: Annotated[float, Meta(ge=1.0, le=1e7)] = 4096.0
    """The oldest of our files in the folder are deleted beyond so many MB in all."""
    free_space: Annotated[float, Meta(ge=0.0, le=1e7)] = 512.0
    """MB that the disk keeps free: the oldest files go; where all would be too few, none does, and
    nothing is recorded."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckpointConfig:
    """What a restart goes on from."""

    file: str = ""
    """Where the state is kept; empty: nowhere, and every start aligns anew."""
    interval: Annotated[float, Meta(ge=0.1, le=60.0)] = 1.0
    """Between two checkpoints, s: what is lost at a crash, on top of the time to start."""
    limit: Annotated[float, Meta(gt=0.0, le=300.0)] = 30.0
    """Age by the autopilot's clock beyond which one is not used, s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HttpConfig:
    """Where our state can be asked for: ``/status``, ``/metrics`` and ``/healthz``."""

    host: str = "127.0.0.1"
    """Whom it listens to: this board only. 0.0.0.0: everybody, and nobody is asked for a name."""
    port: Annotated[int, Meta(ge=0, le=65535)] = 9331
    """0: nowhere. Several vehicles on one board need several."""

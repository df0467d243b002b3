"""Sections of the configuration of the service: link, outputs, recordings, checkpoints."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from msgspec import Meta

from ekf_companion.core.settings.setting import Param, Setting

Identifier = Annotated[int, Meta(ge=1, le=255)]
Rate = Annotated[float, Meta(gt=0.0, le=1000.0), Setting("Hz", reload=True)]
Megabytes = Annotated[float, Meta(ge=1.0, le=1e7), Setting("MB")]


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkConfig:
    """How to reach the autopilot, and who we are on that link."""

    url: str = "udpin:0.0.0.0:14540"
    """Where the autopilot is: serial:/dev/ttyX:BAUD, udpin:HOST:PORT (listen), udpout:HOST:PORT,
    tcp:HOST:PORT, tcpin:HOST:PORT (listen). --link overrides it. PX4 in simulation sends to UDP
    14540 by itself; ArduPilot in simulation listens at tcp:127.0.0.1:5760, or sends here with
    sim_vehicle.py --out=udpout:127.0.0.1:14540. /dev/serial0 is the header's port of a Raspberry
    Pi; over USB, which ignores the rate, take the name under /dev/serial/by-id: it stays."""
    component_id: Identifier = 194
    """Our component id: 194 is MAV_COMP_ID_ONBOARD_COMPUTER4. Take another where some other program
    on this vehicle has it."""
    system_id: Identifier | None = None
    """Our system id. null: the autopilot's, as MAVLink wants it. An id of our own keeps our
    ODOMETRY apart from the autopilot's in MAVROS and MAVSDK, which do not look at the component."""
    autopilot: Identifier | None = None
    """System id of the one autopilot to listen to. null: the first one heard, PX4 and ArduPilot
    before any other. Set it where several are heard."""
    imu_rate: Rate = 250.0
    """Inertial samples to ask for. More follows fast motion better; below 100 flight at the limits
    suffers, below 25 all does. PX4 divides its rate by whole numbers: of 250, 200 asked gives 125.
    ArduPilot knows whole milliseconds (250 is 4 ms) and denies more than 0.8 of SCHED_LOOP_RATE: at
    a loop of 50 Hz ask for 40. At 250 a serial wire carries 19 kB/s of them, a fifth of 921600; at
    57600 ask for 50."""
    gnss_rate: Rate = 10.0
    """GNSS messages to ask for: twice the receiver's rate halves the time that a fix waits."""
    heading_rate: Rate = 10.0
    """ATTITUDE to ask for: the heading of last resort. Lower it on a slow wire."""
    baro_rate: Rate = 10.0
    """SCALED_PRESSURE to ask for, for autopilots whose inertial message has no pressure."""
    peer: str = ""
    """Where UDP datagrams must come from, HOST or HOST:PORT. Empty: whoever first sends a valid
    frame, until silent for 5 s. Others are counted and not heard."""
    allow_systems: tuple[Identifier, ...] = ()
    """System ids that may speak, as in [1, 255]. Empty: all."""
    allow_components: tuple[Identifier, ...] = ()
    """Component ids that may speak, likewise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SigningConfig:
    """MAVLink 2 signing. Both ends must know one secret."""

    key_file: str = ""
    """File of mode 0600, owned by who runs us, with the secret: 32 bytes, or 64 hexadecimal digits
    (openssl rand -hex 32). Empty: nothing is signed. ${CREDENTIALS_DIRECTORY}/NAME is what
    systemd's LoadCredential=NAME:FILE gives."""
    accept_unsigned: bool = False
    """With a key, believe frames without a signature too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TimesyncConfig:
    """How our clock is compared with the autopilot's."""

    request: Annotated[bool, Setting(reload=True)] = True
    """Ask the autopilot for its time."""
    respond: Annotated[bool, Setting(reload=True, param=Param(2, "EC_TSYNC_RESP"))] = True
    """Answer the autopilot's requests: in its own time, once that is known. false where MAVROS
    answers them: two clocks on one port confuse it."""
    largest_rtt: Annotated[float, Meta(gt=0.0, le=1.0), Setting("s", reload=True)] = 0.01
    """Longest round trip of an answer to be used. Raise it on a radio."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryConfig:
    """ODOMETRY: the estimate."""

    mode: Annotated[
        Literal["auto", "always", "never"], Setting(reload=True, param=Param(1, "EC_ODOM_MODE"))
    ] = "auto"
    """auto: streamed unless the autopilot would fuse it together with the GNSS that it came from,
    which we read from its parameters; the log and the status say why nothing is sent, and which
    parameter to change. always: whatever the autopilot does with it. never: only health is sent."""
    independent: Annotated[bool, Setting(reload=True)] = False
    """true where our GNSS and inertial sensor are our own, not the autopilot's: nothing is then
    counted twice, and auto always streams."""
    withhold_in_flight: Annotated[bool, Setting(reload=True)] = False
    """Whether what is no proof also withholds what is streamed already, in auto and in flight: the
    heartbeat of another autopilot, parameters that are no longer answered, somebody under our ids,
    somebody else who sends poses.
    Anybody on the link can forge a heartbeat. On the ground these withhold in any case; in flight a
    parameter that was read and says that GNSS would count twice does."""
    second_source: Annotated[Literal["withhold", "send"], Setting(reload=True)] = "withhold"
    """What becomes of it while somebody else on the link sends the autopilot poses too (ODOMETRY,
    VISION_POSITION_ESTIMATE and their kind), which it fuses by turns with ours. withhold: none is
    sent, but for one that it flies by already. send: it goes on. Both are told."""
    rate: Annotated[
        float,
        Meta(ge=1.0, le=1000.0),
        Setting("Hz", reload=True, param=Param(0, "EC_ODOM_RATE", 1.0, 200.0)),
    ] = 30.0
    """Rate, at most one message per inertial sample. PX4 wants 30 to 50, and fuses nothing that
    comes too rarely; ArduPilot wants 4 to 50, and is sent no more."""
    age_limit: Annotated[float, Meta(ge=0.05, le=60.0), Setting("s", reload=True)] = 0.25
    """An estimate that is older when it could be sent is not sent: what waited to be read while the
    board stood still harms who flies on it. ArduPilot takes a delay of up to 0.25 s
    (VISO_DELAY_MS), PX4 0.3 s (EKF2_EV_DELAY)."""
    not_followed: Annotated[Literal["tell", "withhold"], Setting(reload=True)] = "tell"
    """What happens while the autopilot fuses ODOMETRY and its own estimate is not the same: it is
    told (log, status, pilot), or nothing is sent either, so that its own failsafe acts."""
    frame: Literal["auto", "LOCAL_FRD", "LOCAL_NED", "continuous"] = "auto"
    """Frame of the pose; the numbers are the same. auto: LOCAL_NED to PX4, which takes LOCAL_FRD
    for a frame that may point anywhere: its heading stays unaligned, its global position unknown;
    LOCAL_FRD to others: ArduPilot silently drops any other. With LOCAL_NED to PX4 the velocity is
    LOCAL_NED too, else of the body (BODY_FRD). continuous: a LOCAL_FRD in which position and
    heading never jump, for a controller that must see no step; where it lies in the frame of
    GPS_GLOBAL_ORIGIN is sent as LOCAL_POSITION_NED_SYSTEM_GLOBAL_OFFSET."""
    jumps: Annotated[Literal["auto", "tell", "spread"], Setting(reload=True)] = "auto"
    """What becomes of a correction that nobody would take for motion, as after a loss of GNSS.
    tell: it is sent at once, and reset_counter moves. spread: ODOMETRY goes on without a step, and
    comes to the estimate by 0.5 m/s, 1 m/s2 and 5 deg/s; the covariance covers the rest. auto:
    tell; to ArduPilot, whose filter takes only the position anew, velocity and heading are
    spread."""
    dead_reckoning_time: Annotated[float, Meta(gt=0.0, le=3600.0), Setting("s", reload=True)] = 2.0
    """Without a position or velocity of GNSS for longer, nothing is sent, so that the autopilot's
    own failsafe acts: PX4's 5 s later (EKF2_NOAID_TOUT), ArduPilot's 8 s later."""
    dead_reckoning_std: Annotated[float, Meta(gt=0.0, le=1e4), Setting("m", reload=True)] = 5.0
    """Nor while dead reckoning with a sigma of the horizontal position beyond this, which is where
    PX4 gives a position up (COM_POS_FS_EPH)."""
    estimator_type: Literal["auto", "GPS_INS", "VIO"] = "auto"
    """What ODOMETRY says that it is from. auto: GPS_INS, which is true, but VIO towards PX4, which
    refuses the true type with a critical message for each frame."""
    covariance: Literal["auto", "whole", "relative"] = "auto"
    """What the covariance of the position states. whole: all of its error over ground. relative:
    all but the slow error of the receiver's position, an offset that stays for minutes: what an
    autopilot wants, which takes each message for a measurement with noise of its own. auto:
    relative towards PX4 and ArduPilot, whole towards others and monitors."""
    climb_time: Annotated[float, Meta(ge=0.0, le=10.0), Setting("s")] = 0.5
    """How long an error of our vertical velocity lasts, which no receiver reports in GPS_RAW_INT.
    Who takes thirty messages a second for independent ones believes it far too much, so that with
    relative covariances its variance is stated 2 * climb_time * rate times as large. 0: as it is.
    ArduPilot does not read it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputConfig:
    """What we send back."""

    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    monitors: tuple[str, ...] = ()
    """Listeners that are no autopilot, as in [udpout:192.168.1.5:14550], or udpbcast:HOST:PORT for
    all of a network: each is sent our heartbeat and, whatever odometry.mode is and the guard
    withholds, the estimate (as LOCAL_NED and GPS_INS). Never name what passes it on to an
    autopilot."""
    monitor_position_rate: Annotated[float, Meta(ge=0.0, le=100.0), Setting("Hz", reload=True)] = (
        0.0
    )
    """Rate of GLOBAL_POSITION_INT to the monitors, which maps of ground stations draw: ODOMETRY is
    not drawn by them. 0: none is sent."""
    monitor_system_id: Identifier | None = None
    """System id towards the monitors. null: as on the link, and MAVProxy's map moves one vehicle by
    the positions of both. With an id of our own, as 100, it draws a second one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ParametersConfig:
    """Our own parameters, as a ground station sees them."""

    serve: bool = True
    """Let them be read and set over MAVLink. What is set there is kept beside the checkpoint, and
    this file stays as it is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordConfig:
    """What we keep."""

    path: str | None = None
    """A .tlog of every frame in and out, and of the estimate, about 2 MB a minute; null: none. %s
    in the name becomes the time of start, as in /var/log/ekf-companion/%s.tlog. No file is written
    over: the new one gets a number behind its name. It is on the disk within a second.
    `ekf-companion convert` makes the same estimates of it, to the bit."""
    file_size: Megabytes = 256.0
    """A new file, with a number behind its name, is begun at this size, or half of total_size."""
    total_size: Megabytes = 4096.0
    """The oldest of our files in that folder are deleted beyond this size in all. Ours are those
    whose names path can make: rename what is to be kept."""
    free_space: Annotated[float, Meta(ge=0.0, le=1e7), Setting("MB")] = 512.0
    """What the disk keeps free: the oldest files go; where all would be too few, none does, and
    nothing is recorded."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckpointConfig:
    """What a restart goes on from."""

    file: str = ""
    """Where the estimator's state, 13 kB, is kept for the next start: after a crash it goes on at
    once instead of aligning, with sigmas grown by the time lost. Empty: nowhere. --checkpoint
    overrides it, and the systemd unit gives it /var/lib/ekf-companion/checkpoint. A file in /run
    spares an SD card."""
    interval: Annotated[float, Meta(ge=0.1, le=60.0), Setting("s")] = 1.0
    """Between two checkpoints: what a crash loses, on top of the time to start."""
    limit: Annotated[float, Meta(gt=0.0, le=300.0), Setting("s")] = 30.0
    """Age by the autopilot's clock beyond which a checkpoint is not used."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HttpConfig:
    """The page in a browser, and for programs /status (JSON), /metrics (Prometheus), /healthz."""

    host: str = "127.0.0.1"
    """Who may ask: 127.0.0.1 is this computer only; 0.0.0.0 is everybody who can reach it and knows
    the token."""
    port: Annotated[int, Meta(ge=0, le=65535)] = 9331
    """0: nowhere. Several vehicles on one board need several."""
    token: str = ""
    """What other computers must know: 8 letters, digits or . _ ~ - at least. Empty: one is drawn at
    each start, and logged with the address to open. This computer is never asked."""
    names: tuple[str, ...] = ()
    """Names under which a browser may ask for this computer, beside its address, localhost and its
    host name, as in [drone.lan]. Others are refused: a page of another site could have made its
    name point here."""
    tiles: str = ""
    """Address of map tiles to draw under the track, of the page, view and report, with {z}, {x} and
    {y}, as in https://tiles.example.org/{z}/{x}/{y}.png. The browser fetches them from there, and
    so tells that server where the vehicle is. Empty: no map."""
    tiles_credit: str = ""
    """What the server wants to be written on the map, as in (c) OpenStreetMap contributors."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveConfig:
    """The estimate, ten times a second, for programs that draw it."""

    udp_json: str = ""
    """PlotJuggler, or whoever reads JSON from UDP: HOST:PORT, as in 192.168.1.5:9870. Empty:
    nobody. The field timestamp is unix time, s."""
    foxglove_port: Annotated[int, Meta(ge=0, le=65535)] = 0
    """Port of this computer, usually 8765, at which Foxglove connects to ws://127.0.0.1:8765 (from
    elsewhere by ssh -L). Needs the extra foxglove. 0: none."""
    foxglove_origins: tuple[str, ...] = ("https://app.foxglove.dev",)
    """Sites whose pages may connect there. Programs that are no browser always may; a page of any
    other site is refused and its origin logged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PreflightConfig:
    """What the verdict before take-off asks for."""

    needs_fix: Annotated[bool, Setting(reload=True)] = True
    """Whether a position is needed to take off. false for a vehicle that flies without GNSS, as
    indoors: then attitude and heading are enough."""

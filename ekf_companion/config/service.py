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
    """The link to the autopilot, and our ids on it."""

    url: str = "udpin:0.0.0.0:14540"
    """The autopilot's link: serial:/dev/ttyX:BAUD, udpin:HOST:PORT (listen), udpout:HOST:PORT,
    tcp:HOST:PORT, tcpin:HOST:PORT (listen). --link overrides it. PX4 in simulation sends to UDP
    14540 by itself; ArduPilot in simulation listens at tcp:127.0.0.1:5760, or sends here with
    sim_vehicle.py --out=udpout:127.0.0.1:14540. /dev/serial0 is the header's port of a Raspberry
    Pi; over USB, which ignores the rate, use the name under /dev/serial/by-id, which does not
    change."""
    component_id: Identifier = 194
    """Our component id: 194 is MAV_COMP_ID_ONBOARD_COMPUTER4. Change it if another program on this
    vehicle uses it."""
    system_id: Identifier | None = None
    """Our system id. null: the autopilot's, as MAVLink recommends. A different id separates our
    ODOMETRY from the autopilot's in MAVROS and MAVSDK, which ignore the component."""
    autopilot: Identifier | None = None
    """System id of the one autopilot to listen to. null: the first one heard, PX4 and ArduPilot
    before any other. Set it where several are heard."""
    imu_rate: Rate = 250.0
    """Rate of inertial samples to request. A higher rate follows fast motion better: below 100
    aggressive flight suffers, below 25 every flight. PX4 divides its rate by whole numbers: of 250,
    200 requested gives 125. ArduPilot uses whole milliseconds (250 is 4 ms) and denies more than
    0.8 of SCHED_LOOP_RATE: at a loop of 50 Hz request 40. At 250 they take 19 kB/s, a fifth of a
    serial link of 921600; at 57600 request 50."""
    spare_imu_rate: Rate = 10.0
    """Rate of SCALED_IMU2 and SCALED_IMU3 to request of an ArduPilot, with the other compasses and
    inertial units. 10 is enough for compasses. From a quarter of imu_rate on, at 100, the inertial
    units are judged by each other, and one that fails is left within 0.2 s: 3.6 kB/s each."""
    gnss_rate: Rate = 10.0
    """Rate of GNSS messages to request: twice the receiver's rate halves the delay of a fix."""
    heading_rate: Rate = 10.0
    """Rate of ATTITUDE to request: the heading of last resort. Lower it on a slow link."""
    baro_rate: Rate = 10.0
    """Rate of SCALED_PRESSURE to request, for autopilots whose inertial message has no pressure."""
    peer: str = ""
    """Sender of UDP datagrams to accept, HOST or HOST:PORT. Empty: the first that sends a valid
    frame, until it is silent for 5 s. Others are counted and ignored."""
    allow_systems: tuple[Identifier, ...] = ()
    """System ids to accept, as in [1, 255]. Empty: all."""
    allow_components: tuple[Identifier, ...] = ()
    """Component ids to accept, likewise."""
    aid_url: str = ""
    """Second port, at which software of this board sends poses and velocities (ODOMETRY, VISION_*),
    as in udpin:127.0.0.1:14560; visual_odometry.use or visual_velocity.use must be true. Empty:
    none."""
    aid_peers: tuple[str, ...] = ()
    """Hosts whose datagrams it accepts, as in [192.168.1.7]. Empty: this board only."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SigningConfig:
    """MAVLink 2 signing. Both ends must know one secret."""

    key_file: str = ""
    """File of mode 0600, owned by the daemon's user, with the secret: 32 bytes, or 64 hexadecimal
    digits (openssl rand -hex 32). Empty: nothing is signed. ${CREDENTIALS_DIRECTORY}/NAME is the
    file of systemd's LoadCredential=NAME:FILE."""
    accept_unsigned: bool = False
    """With a key, accept frames without a signature too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TimesyncConfig:
    """How our clock is compared with the autopilot's."""

    request: Annotated[bool, Setting(reload=True)] = True
    """Ask the autopilot for its time."""
    respond: Annotated[bool, Setting(reload=True, param=Param(2, "EC_TSYNC_RESP"))] = True
    """Answer the autopilot's requests, in its own time once that is known. false where MAVROS
    answers them: two clocks on one port confuse it."""
    largest_rtt: Annotated[float, Meta(gt=0.0, le=1.0), Setting("s", reload=True)] = 0.01
    """Longest round trip of an answer to be used. Raise it on a radio."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryConfig:
    """ODOMETRY: the estimate."""

    mode: Annotated[
        Literal["auto", "always", "never"], Setting(reload=True, param=Param(1, "EC_ODOM_MODE"))
    ] = "auto"
    """auto: sent unless the autopilot would fuse it together with the GNSS that it is made from, as
    its parameters show; log and status name the reason and the parameter to change. always: sent
    whatever the autopilot does with it. never: only health is sent."""
    independent: Annotated[bool, Setting(reload=True)] = False
    """true where our GNSS and inertial sensors are not the autopilot's: nothing is then counted
    twice, and auto always sends."""
    withhold_in_flight: Annotated[bool, Setting(reload=True)] = False
    """Whether a mere suspicion stops ODOMETRY in flight too, in auto: the heartbeat of another
    autopilot, parameters that are no longer answered, another sender with our ids, another sender
    of poses. Anybody on the link can forge a heartbeat. On the ground these always stop it; in
    flight only a parameter does that was read and shows that GNSS would count twice."""
    second_source: Annotated[Literal["withhold", "send"], Setting(reload=True)] = "withhold"
    """What happens while another sender on the link sends poses to the autopilot too (ODOMETRY,
    VISION_POSITION_ESTIMATE and similar), which it would fuse in turn with ours. withhold: ODOMETRY
    stops, unless the autopilot flies on it already. send: it continues. Both are reported."""
    rate: Annotated[
        float,
        Meta(ge=1.0, le=1000.0),
        Setting("Hz", reload=True, param=Param(0, "EC_ODOM_RATE", 1.0, 200.0)),
    ] = 30.0
    """Rate, at most one message per inertial sample. PX4 expects 30 to 50, and fuses no slower
    ones; ArduPilot expects 4 to 50, and is sent no more."""
    age_limit: Annotated[float, Meta(ge=0.05, le=60.0), Setting("s", reload=True)] = 0.25
    """An estimate older than this is not sent: after a stall of the board, old estimates harm an
    autopilot that flies on them. ArduPilot allows a delay of up to 0.25 s (VISO_DELAY_MS), PX4 0.3
    s (EKF2_EV_DELAY)."""
    not_followed: Annotated[Literal["tell", "withhold"], Setting(reload=True)] = "tell"
    """What happens while the autopilot fuses ODOMETRY but its own estimate differs from it. tell:
    that is reported (log, status, pilot). withhold: ODOMETRY stops too, so that its own failsafe
    acts."""
    message: Literal["auto", "odometry", "vision_position_estimate"] = "auto"
    """auto: ODOMETRY, but VISION_POSITION_ESTIMATE to firmware that does not read it, by its
    version: PX4 before 1.9, ArduPilot before 4.1. With VISION_POSITION_ESTIMATE, not to PX4, goes
    VISION_SPEED_ESTIMATE. All that is said of ODOMETRY holds for these too, but they are always
    LOCAL_NED and state no quality."""
    frame: Literal["auto", "LOCAL_FRD", "LOCAL_NED", "continuous"] = "auto"
    """Frame of the pose; the numbers are the same. auto: LOCAL_NED to PX4, for which LOCAL_FRD may
    point anywhere: its heading would stay unaligned, its global position unknown; LOCAL_FRD to
    others: ArduPilot silently drops any other. With LOCAL_NED to PX4 the velocity is LOCAL_NED too,
    else that of the body (BODY_FRD). continuous: a LOCAL_FRD in which position and heading never
    jump, for a controller that must not see a step; its offset to the frame of GPS_GLOBAL_ORIGIN is
    sent as LOCAL_POSITION_NED_SYSTEM_GLOBAL_OFFSET."""
    jumps: Annotated[Literal["auto", "tell", "spread"], Setting(reload=True)] = "auto"
    """How a correction is sent that cannot be motion, as after a loss of GNSS. tell: at once, and
    reset_counter increases. spread: without a step; ODOMETRY approaches the estimate by 0.5 m/s, 1
    m/s2 and 5 deg/s, and its covariance covers the difference. auto: tell; to ArduPilot, whose
    filter resets only the position, velocity and heading are spread."""
    dead_reckoning_time: Annotated[float, Meta(gt=0.0, le=3600.0), Setting("s", reload=True)] = 2.0
    """Longest time without a position or velocity of GNSS; then ODOMETRY stops, so that the
    autopilot's own failsafe acts: PX4's 5 s later (EKF2_NOAID_TOUT), ArduPilot's 8 s later."""
    dead_reckoning_std: Annotated[float, Meta(gt=0.0, le=1e4), Setting("m", reload=True)] = 5.0
    """Largest sigma of the horizontal position while dead reckoning; then ODOMETRY stops. PX4 drops
    a position at the same limit (COM_POS_FS_EPH)."""
    estimator_type: Literal["auto", "GPS_INS", "VIO"] = "auto"
    """Source that ODOMETRY names. auto: GPS_INS, which is true, but VIO to PX4, which refuses the
    true type with a critical message for each frame."""
    covariance: Literal["auto", "whole", "relative"] = "auto"
    """What the covariance of the position includes. whole: its whole error over ground. relative:
    all but the slow error of the receiver's position, an offset that is constant for minutes: suits
    an autopilot, which assumes independent noise in each message. auto: relative to PX4 and
    ArduPilot, whole to others and monitors."""
    climb_time: Annotated[float, Meta(ge=0.0, le=10.0), Setting("s")] = 0.5
    """Correlation time of the error of our vertical velocity, which no receiver reports in
    GPS_RAW_INT. An autopilot that takes thirty messages a second as independent trusts it too much,
    so with relative covariances its variance is stated 2 * climb_time * rate times as large. 0: as
    it is. ArduPilot does not read it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GlobalPositionConfig:
    """A latitude and longitude, for an autopilot that fuses no ODOMETRY."""

    rate: Annotated[float, Meta(ge=0.0, le=50.0), Setting("Hz", reload=True)] = 0.0
    """Rate of GLOBAL_POSITION_SENSOR to PX4, which fuses it in place of GNSS, and of
    MAV_CMD_EXTERNAL_POSITION_ESTIMATE to ArduPilot, which moves to it while it has no position of
    its own. Withheld where the GNSS in it would count twice. 0: none is sent."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputConfig:
    """What we send."""

    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    global_position: GlobalPositionConfig = field(default_factory=GlobalPositionConfig)
    monitors: tuple[str, ...] = ()
    """Listeners that are not autopilots, as in [udpout:192.168.1.5:14550], or udpbcast:HOST:PORT
    for a whole network. Each is sent our heartbeat and the estimate (as LOCAL_NED and GPS_INS),
    whatever odometry.mode is, even if the guard withholds it. Never name one that forwards to an
    autopilot."""
    monitor_position_rate: Annotated[float, Meta(ge=0.0, le=100.0), Setting("Hz", reload=True)] = (
        0.0
    )
    """Rate of GLOBAL_POSITION_INT to the monitors, for the maps of ground stations, which do not
    draw ODOMETRY. 0: none is sent."""
    monitor_system_id: Identifier | None = None
    """System id towards the monitors. null: as on the link; MAVProxy's map then moves one vehicle
    by both positions. With another id, as 100, it draws a second one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ParametersConfig:
    """Our own parameters, as a ground station sees them."""

    serve: bool = True
    """Let them be read and set over MAVLink. Values set there are stored beside the checkpoint;
    this file stays as it is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordConfig:
    """Recordings."""

    path: str | None = None
    """A .tlog of every frame in and out, and of the estimate, about 2 MB a minute; null: none. %s
    in the name becomes the time of start, as in /var/log/ekf-companion/%s.tlog. No file is
    overwritten: a new one gets a number behind its name. Data is on the disk within a second.
    `ekf-companion convert` makes the same estimates of it, to the bit."""
    file_size: Megabytes = 256.0
    """Size at which a new file, with a number behind its name, is begun; at most half of
    total_size."""
    total_size: Megabytes = 4096.0
    """Total size beyond which the oldest of our files in that folder are deleted. Ours are those
    whose names path can make: rename a file to keep it."""
    free_space: Annotated[float, Meta(ge=0.0, le=1e7), Setting("MB")] = 512.0
    """Space to leave free on the disk: the oldest files are deleted; if all of them are too small,
    none is, and recording stops."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckpointConfig:
    """The state that a restart resumes from."""

    file: str = ""
    """File of the estimator's state, 17 kB, for the next start: after a crash the estimate resumes
    at once instead of aligning, with sigmas grown by the time lost. Empty: none. --checkpoint
    overrides it, and the systemd unit sets /var/lib/ekf-companion/checkpoint. A file in /run spares
    an SD card."""
    interval: Annotated[float, Meta(ge=0.1, le=60.0), Setting("s")] = 1.0
    """Time between two checkpoints: a crash loses as much, plus the time to start."""
    limit: Annotated[float, Meta(gt=0.0, le=300.0), Setting("s")] = 30.0
    """Age by the autopilot's clock beyond which a checkpoint is not used."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HttpConfig:
    """The page in a browser, and for programs /status (JSON), /metrics (Prometheus), /healthz."""

    host: str = "127.0.0.1"
    """Address to listen at: 127.0.0.1 is this computer only; 0.0.0.0 every computer that can reach
    it and knows the token."""
    port: Annotated[int, Meta(ge=0, le=65535)] = 9331
    """Port; several vehicles on one board need several. 0: no page."""
    token: str = ""
    """Token for other computers: 8 letters, digits or . _ ~ - at least. Empty: one is drawn at each
    start, and logged with the address to open. This computer needs none."""
    names: tuple[str, ...] = ()
    """Host names of this computer that a browser may use, beside its address, localhost and its own
    host name, as in [drone.lan]. Others are refused, since another site could let its name point
    here."""
    tiles: str = ""
    """Address of map tiles to draw under the track, on the page, in view and report, with {z}, {x}
    and {y}, as in https://tiles.example.org/{z}/{x}/{y}.png. The browser fetches them from that
    server, which so learns where the vehicle is. Empty: no map."""
    tiles_credit: str = ""
    """Attribution that the server requires on the map, as in (c) OpenStreetMap contributors."""

    @property
    def url(self) -> str:
        """Return the page's address on this computer; empty if there is none."""
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.host, self.host)
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}" if self.port else ""


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveConfig:
    """The estimate, ten times a second, for programs that draw it."""

    udp_json: str = ""
    """Address of PlotJuggler, or any reader of JSON over UDP: HOST:PORT, as in 192.168.1.5:9870.
    Empty: none. The field timestamp is unix time, s."""
    foxglove_port: Annotated[int, Meta(ge=0, le=65535)] = 0
    """Port of this computer, usually 8765, at which Foxglove connects to ws://127.0.0.1:8765 (from
    elsewhere by ssh -L). Needs the extra foxglove. 0: none."""
    foxglove_origins: tuple[str, ...] = ("https://app.foxglove.dev",)
    """Sites whose pages may connect there. Programs other than browsers always may; a page of any
    other site is refused and its origin logged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PreflightConfig:
    """What the verdict before take-off requires."""

    needs_fix: Annotated[bool, Setting(reload=True)] = True
    """Whether a position is needed to take off. false for a vehicle that flies without GNSS, as
    indoors: then attitude and heading are enough."""

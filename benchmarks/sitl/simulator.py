"""The simulators as processes: PX4's with its built-in quadrotor, and ArduPilot's vehicles.

All are started in a folder of their own and listen on the loopback interface only. None is
built or fetched here: the path of a built one is given.
"""

from __future__ import annotations

import os
import subprocess
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar

from benchmarks.sitl.pilot import Pilot
from benchmarks.sitl.place import HOME
from benchmarks.sitl.process import end
from benchmarks.sitl.tracks import Flown, from_ardupilot, from_px4
from ekf_companion.errors import CompanionError

_SET_EKF_SOURCE_SET = 42007
"""MAV_CMD."""
ALONE = {"ARMING_SKIPCHK": 1 << 18}
"""With this ArduPilot arms without ODOMETRY, though VISO_TYPE is set."""
_PARTS = ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")


Values = Mapping[str, float]
"""Parameters by name."""


class Simulator(ABC):
    """One simulated vehicle."""

    name: str
    companion: str
    """Link of the daemon."""
    pilot: str
    """Link of the ground station, as pymavlink names it."""
    always: ClassVar[Values]
    """Parameters of every flight."""
    flown_on: ClassVar[Values]
    """Parameters to fly on ODOMETRY: those of docs/ODOMETRY.md."""
    alternative: ClassVar[Values]
    """Parameters to fly on its own receiver, and change to ODOMETRY in flight."""
    receiver: str
    """Parameter that switches the receiver."""
    receiver_on: float
    receiver_off: float
    parts: ClassVar[Sequence[str] | None] = None
    """Parts that it can fly; None: all."""
    rebooted: ClassVar[Values] = {}
    """What its sensors do otherwise after a reboot: those of a device never repeat themselves."""
    calm: ClassVar[int] = 0
    """Hovers of ten seconds before a switch or a kill, by which its own wandering is known."""

    def __init__(self, binary: Path, instance: int = 0) -> None:
        """Prepare it.

        Args:
            binary: The path of a built one.
            instance: Its ports are ten further for each.
        """
        self.binary, self.instance = binary.resolve(), instance
        self._process: subprocess.Popen[bytes] | None = None

    @abstractmethod
    def command(self, folder: Path, parameters: Mapping[str, float]) -> list[str]:
        """Return the command that starts it in a folder."""

    def environment(self, parameters: Mapping[str, float]) -> dict[str, str]:
        """Return the variables that it is started with."""
        return dict(os.environ)

    @abstractmethod
    def change(self, pilot: Pilot, *, is_into: bool) -> None:
        """Change to ODOMETRY in flight, or back to the receiver."""

    @abstractmethod
    def flown(self, folder: Path, recordings: Sequence[Path]) -> Flown:
        """Read the last log of a folder, and all recordings of the daemon."""

    def start(self, folder: Path, parameters: Mapping[str, float]) -> None:
        """Start it; its log goes to a file."""
        both = {**self.always, **parameters}
        command = self.command(folder, both)
        with (folder / "simulator.log").open("ab") as log:
            self._process = subprocess.Popen(
                command,
                cwd=folder,
                env=self.environment(both),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    def check(self) -> None:
        """Raise if it has ended by itself."""
        if self._process is not None and self._process.poll() is not None:
            raise CompanionError(f"{self.binary}: ended by itself; see simulator.log")

    def stop(self) -> None:
        """End it."""
        end(self._process)


class Px4(Simulator):
    """PX4 with its simulation in hardware (SIH), quadrotor X, airframe 10040."""

    name = "PX4"
    companion = "udpin:127.0.0.1:14540"
    pilot = "udpin:127.0.0.1:14550"
    # Nobody holds a remote control
    always: ClassVar[Values] = {
        "COM_RC_IN_MODE": 4,
        "COM_RCL_EXCEPT": 4,
        "NAV_DLL_ACT": 0,
        "CBRK_SUPPLY_CHK": 894281,
    }
    flown_on: ClassVar[Values] = {
        "EKF2_EV_CTRL": 15,
        "EKF2_GPS_CTRL": 0,
        "EKF2_HGT_REF": 3,
        "EKF2_BARO_CTRL": 0,
        "EKF2_MAG_TYPE": 5,
        "EKF2_ABIAS_INIT": 0.05,
    }
    alternative: ClassVar[Values] = {}
    receiver, receiver_on, receiver_off = "SIM_GPS_USED", 10, 0
    # It wanders by half a metre in the hover
    calm = 10
    parts = ("paths", "outage", "restart", "switch", "endurance", "reboot", "late", "links")

    def command(self, folder: Path, parameters: Mapping[str, float]) -> list[str]:
        """Return the command of ``build/px4_sitl_default/bin/px4``."""
        etc = self.binary.parent.parent / "etc"
        if not etc.is_dir():
            raise CompanionError(f"{etc}: is not there; give the path of bin/px4 in a build of PX4")
        return [str(self.binary), "-d", str(etc), "-w", str(folder), "-i", "0"]

    def environment(self, parameters: Mapping[str, float]) -> dict[str, str]:
        """Return the variables that choose the model and set parameters."""
        lat, lon, alt = (float(one) for one in HOME)
        model = {"PX4_SIM_MODEL": "sihsim_quadx", "PX4_SIMULATOR": "sihsim"}
        home = {"PX4_HOME_LAT": str(lat), "PX4_HOME_LON": str(lon), "PX4_HOME_ALT": str(alt)}
        values = {f"PX4_PARAM_{name}": f"{value:g}" for name, value in parameters.items()}
        return {**os.environ, **model, **home, **values}

    def change(self, pilot: Pilot, *, is_into: bool) -> None:
        """Set what is fused: in, ODOMETRY follows at once; back, GNSS needs a second to begin."""
        gnss, vision = ("EKF2_GPS_CTRL", 0.0 if is_into else 7.0), ("EKF2_EV_CTRL", 15.0 * is_into)
        pilot.set(*gnss)
        if not is_into:
            pilot.wait(1.5)
        pilot.set(*vision)

    def flown(self, folder: Path, recordings: Sequence[Path]) -> Flown:
        """Read the last .ulg."""
        return from_px4(sorted(folder.glob("log/*/*.ulg"))[-1], recordings)


class ArduPilot(Simulator):
    """One of ArduPilot's vehicles in its software in the loop."""

    model: ClassVar[str]
    defaults: ClassVar[str] = ""
    """File of parameters in ArduPilot's tree; empty: none."""
    flown_on: ClassVar[Values] = {
        "VISO_TYPE": 1,
        "VISO_DELAY_MS": 0,
        **{f"EK3_SRC1_{part}": 6 for part in _PARTS},
    }
    alternative: ClassVar[Values] = {
        "VISO_TYPE": 1,
        "VISO_DELAY_MS": 0,
        "EK3_SRC_OPTIONS": 0,
        **{f"EK3_SRC2_{part}": 6 for part in _PARTS},
    }
    receiver, receiver_on, receiver_off = "SIM_GPS1_ENABLE", 1, 0
    # Else its messages at rest are the same bytes, and count as heard before
    rebooted: ClassVar[Values] = {"SIM_ACC1_BIAS_X": 0.02, "SIM_ACC1_BIAS_Y": 0.01}

    def __init__(self, binary: Path, instance: int = 0) -> None:
        """Prepare it, with the ports of its instance."""
        super().__init__(binary, instance)
        self.pilot, self.companion, self.other = (
            f"tcp:127.0.0.1:{port + 10 * instance}" for port in (5760, 5762, 5763)
        )

    def command(self, folder: Path, parameters: Mapping[str, float]) -> list[str]:
        """Return the command of ``build/sitl/bin/arducopter``, or of another vehicle."""
        own = folder / "flight.parm"
        lines = [f"{name} {value:g}" for name, value in parameters.items()]
        own.write_text("\n".join(lines) + "\n", encoding="ascii")
        files = [str(own)]
        if self.defaults:
            usual = self.binary.parents[3] / "Tools" / "autotest" / self.defaults
            if not usual.exists():
                raise CompanionError(f"{usual}: is not there; give a binary in ArduPilot's tree")
            files.insert(0, str(usual))
        place = f"{HOME.lat},{HOME.lon},{HOME.alt},0"
        base = [str(self.binary), "--model", self.model, "--speedup", "1"]
        base += ["--defaults", ",".join(files)]
        return [*base, "--home", place, "--wipe", f"-I{self.instance}"]

    def change(self, pilot: Pilot, *, is_into: bool) -> None:
        """Choose the source set."""
        pilot.command(_SET_EKF_SOURCE_SET, 2.0 if is_into else 1.0)

    def flown(self, folder: Path, recordings: Sequence[Path]) -> Flown:
        """Read the last .BIN."""
        return from_ardupilot(sorted(folder.glob("logs/*.BIN"))[-1], recordings)


_COMMON: Values = {
    "LOG_DISARMED": 1,
    # Noise, since two equal readings of a magnetometer count as one: without it the heading is
    # not believed, and the vehicle does not arm
    "SIM_MAG_RND": 5,
    "SIM_BARO_RND": 0.2,
    "FS_GCS_ENABLE": 0,
    "SERIAL1_PROTOCOL": 2,
    # It takes off the time that a message needs on a wire of this speed: on TCP none
    "SERIAL1_BAUD": 1500,
}


class ArduCopter(ArduPilot):
    """ArduCopter, model quad."""

    name = "ArduCopter"
    model = "quad"
    parts = (
        *("paths", "outage", "restart", "switch", "endurance", "reboot", "cold", "late", "stale"),
        *("fix", "links", "second", "compass", "receivers", "faults", "moving", "legs"),
    )
    # A frame, calibrated sensors
    always: ClassVar[Values] = {
        **_COMMON,
        "FRAME_CLASS": 1,
        "FRAME_TYPE": 0,
        "MOT_THST_EXPO": 0.65,
        "MOT_THST_HOVER": 0.39,
        "ATC_RAT_YAW_P": 0.3,
        "ATC_RAT_YAW_I": 0.02,
        **{f"COMPASS_OFS{k}_X": 5 for k in ("", 2, 3)},
        **{f"COMPASS_OFS{k}_Y": 13 for k in ("", 2, 3)},
        **{f"COMPASS_OFS{k}_Z": -18 for k in ("", 2, 3)},
        **{f"INS_ACC{k}OFFS_{axis}": 0.001 for k in ("", 2) for axis in "XYZ"},
        **{f"INS_ACC{k}SCAL_{axis}": 1.001 for k in ("", 2) for axis in "XYZ"},
        "FS_THR_ENABLE": 0,
    }


class ArduPlane(ArduPilot):
    """ArduPlane, model plane."""

    name = "ArduPlane"
    model = "plane"
    defaults = "models/plane.parm"
    always: ClassVar[Values] = {
        **_COMMON,
        "FS_LONG_ACTN": 0,
        "FS_SHORT_ACTN": 3,
        "THR_FAILSAFE": 0,
        "TERRAIN_ENABLE": 0,
    }
    parts = ("fix", "wing")


class Rover(ArduPilot):
    """Rover, model rover."""

    name = "Rover"
    model = "rover"
    defaults = "default_params/rover.parm"
    always: ClassVar[Values] = {**_COMMON, "FS_THR_ENABLE": 0}
    parts = ("fix",)

"""Reading of a BROAD trial (.mat): a hand-held inertial and magnetic sensor, and optical truth.

The sensor's axes are x right, y forward, z up, its reference frame is east-north-up; here they are
forward-right-down and north-east-down. Both change by swapping the first two axes and negating the
third, so a quaternion's vector part changes like any vector.

Source: Laidig, Caruso, Cereatti, Seel 2021, "BROAD: a benchmark for robust inertial orientation
estimation", Data 6(7), doi 10.3390/data6070072.
"""

from __future__ import annotations

import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.errors import LogError, part_of
from ekf_companion.logs.recording import Counted, Recording
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Stamps, known_rows
from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.nav.state import Trajectory

with part_of("filters", "a .mat file"):
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

GAUSS = 0.01
"""gauss per microtesla."""
FIELDS = {"imu_gyr": 3, "imu_acc": 3, "imu_mag": 3, "opt_quat": 4}
"""Arrays of a trial, and their columns."""
OF_PYTHON = (ValueError, TypeError, LookupError, OSError, ArithmeticError, AttributeError, EOFError)
DAMAGE = (*OF_PYTHON, AssertionError, MemoryError, zlib.error, struct.error, MatReadError, Warning)
"""Exceptions of SciPy's reader on a damaged file."""


def read(path: Path) -> Recording:
    """Read a trial. The first sample is at time zero; yaw is relative to magnetic north.

    Raises:
        LogError: The file is missing, damaged, or not a trial of BROAD.
    """
    content = _load(path)
    arrays = {name: _array(path, content, name, width) for name, width in FIELDS.items()}
    counts = {name: len(array) for name, array in arrays.items()}
    movement = np.atleast_1d(np.squeeze(content.get("movement", np.ones(counts["imu_gyr"]))))
    if len({*counts.values(), len(movement)}) != 1 or movement.ndim != 1:
        raise LogError(
            f"{path}: its arrays differ in length ({counts}, movement {len(movement)}), so no "
            "sample has a time; fetch the file anew"
        )
    rate = np.squeeze(content.get("sampling_rate", np.nan))
    if rate.shape or rate.dtype.kind not in "fiu" or not 1.0 <= float(rate) <= 1e5:
        raise LogError(f"{path}: has no sampling_rate in Hz, so no sample has a time")
    t_ns = np.rint(np.arange(len(movement)) * (1e9 / float(rate))).astype(np.int64)
    q_nb = _forward_right_down(arrays["opt_quat"])
    seen = known_rows(q_nb) & (np.abs(q_nb).sum(axis=1) > 0.0)
    return Recording(
        family="unknown",
        events=_events(t_ns, arrays),
        truth=Trajectory(
            name="optical motion capture (opt_quat)",
            att_t_ns=t_ns[seen],
            q_nb=so3.normalise(q_nb[seen]),
        )
        if seen.any()
        else None,
        counted=Counted(t_ns=t_ns, is_counted=movement.astype(bool)),
        notes=("the frame of a BROAD trial points to magnetic north: yaw counts from there",),
    )


def _load(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise LogError(f"{path}: there is no such file")
    try:
        with warnings.catch_warnings():
            # A file that SciPy warns of is no trial either
            warnings.simplefilter("error")
            content: dict[str, Any] = loadmat(path)
    except NotImplementedError as error:
        raise LogError(
            f"{path}: is a MATLAB 7.3 file, which is not read here; save it with -v7"
        ) from error
    except DAMAGE as error:
        raise LogError(
            f"{path}: is no MATLAB file of version 5 to 7, or is cut short; fetch it anew"
        ) from error
    return content


def _array(path: Path, content: dict[str, Any], name: str, width: int) -> Array:
    if name not in content:
        raise LogError(f"{path}: has no {name}, so it is no trial of BROAD, whose .mat are read")
    value = np.asarray(content[name])
    if value.dtype.kind not in "fiu" or value.ndim != 2 or value.shape[1] != width:
        raise LogError(f"{path}: {name} is {value.dtype} of {value.shape}, not of (n, {width})")
    if not len(value):
        raise LogError(f"{path}: {name} is empty: there is nothing to estimate from")
    return np.asarray(value, dtype=np.float64)


def _forward_right_down(values: Array) -> Array:
    """Rotate vectors, or vector parts of quaternions, from right-forward-up (or ENU) to ours."""
    turned: Array = np.array(values)
    turned[:, -3:] = values[:, [-2, -3, -1]] * [1.0, 1.0, -1.0]
    return turned


def _events(t_ns: Stamps, arrays: dict[str, Array]) -> Events:
    """Return the samples, without rows that hold a NaN: those were lost."""
    motion = np.hstack([_forward_right_down(arrays[name]) for name in ("imu_gyr", "imu_acc")])
    field = _forward_right_down(arrays["imu_mag"]) * GAUSS
    parts = []
    for kind, values in ((Kind.MAG, field), (Kind.IMU, motion)):
        good = known_rows(values)
        parts.append(Events.from_columns(t_ns[good], kind, *values[good].T))
    return merge(*parts)

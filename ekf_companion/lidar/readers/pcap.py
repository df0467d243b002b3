"""Packets of Ouster and Velodyne as .pcap, by the makers' and maintained decoders."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.errors import LogError, part_of
from ekf_companion.lidar.readers.folder import read_inertial
from ekf_companion.lidar.readers.sequence import proper, read_calib
from ekf_companion.lidar.readers.source import Source, StoredInertial, StoredScan
from ekf_companion.lidar.recording import Mounting

_VELODYNE = {
    0x21: "HDL32E",
    0x22: "VLP16",
    0x24: "PuckHiRes",
    0x28: "VLP32C",
    0xA1: "AlphaPrime",
}
"""The decoder's names of the models, by the last byte of a packet."""
_PACKET = 1206
"""Bytes of a Velodyne packet."""


def open_pcap(path: Path, imu: str | None) -> Source:
    """Open a .pcap: Ouster's where its metadata (.json) lie beside it, else Velodyne's.

    Raises:
        LogError: It is damaged, or of neither.
        MissingPackageError: The decoder is not installed.
    """
    metadata = path.with_suffix(".json")
    if metadata.is_file():
        return _open_ouster(path, metadata)
    return _open_velodyne(path, imu)


def _open_ouster(path: Path, metadata: Path) -> Source:
    with part_of("ouster", f"reading {path.name}"):
        from ouster.sdk import open_packet_source
        from ouster.sdk.core import ImuPacket
    try:
        json.loads(metadata.read_text())
        rows = []
        source = open_packet_source(str(path), meta=[str(metadata)])
        info = source.sensor_info[0]
        for item in source:
            packet = item[1] if isinstance(item, tuple) else item
            if isinstance(packet, ImuPacket):
                stamps = np.atleast_1d(packet.gyro_ts()).astype(np.int64)
                for row in zip(stamps, packet.gyro(), packet.accel(), strict=True):
                    rows.append((row[0] / 1e9, *row[1], *row[2]))
        to_sensor = np.asarray(info.imu_to_sensor_transform, np.float64)
    except (RuntimeError, ValueError, OSError, IndexError) as error:
        raise LogError(f"{path}: Ouster's SDK cannot read it: {error}") from None
    table = np.array(rows, np.float64).reshape(-1, 7)
    turned = to_sensor[:3, :3].T
    mounting = proper(Mounting(turned, -turned @ to_sensor[:3, 3] * 1e-3), str(metadata))
    return Source(
        name=path.name,
        scans=lambda: _ouster_scans(path, metadata),
        inertial=StoredInertial(table[:, 0], table[:, 1:4], table[:, 4:7]),
        mounting=mounting,
        notes=("an Ouster: the mounting is that of its metadata",),
        time_field="column timestamp",
        inertial_name="packets of its inertial sensor",
    )


def _ouster_scans(path: Path, metadata: Path) -> Iterator[StoredScan]:
    from ouster.sdk import open_source
    from ouster.sdk.core import XYZLut

    try:
        source = open_source(str(path), meta=[str(metadata)])
        to_points = XYZLut(source.sensor_info[0])
        for frames in source:
            frame: Any = frames[0]
            if frame is None:
                continue
            valid = (np.asarray(frame.status) & 1).astype(bool)
            stamps = np.asarray(frame.timestamp).astype(np.int64)[valid]
            if not len(stamps):
                continue
            points = np.asarray(to_points(frame), np.float64)[:, valid]
            lasers, columns = points.shape[:2]
            yield StoredScan(
                stamps.min() / 1e9,
                points.reshape(-1, 3),
                np.tile(stamps - stamps.min(), lasers),
                np.repeat(np.arange(lasers, dtype=np.uint16), columns),
            )
    except (RuntimeError, ValueError, OSError, IndexError) as error:
        raise LogError(f"{path}: Ouster's SDK cannot read it: {error}") from None


def _open_velodyne(path: Path, imu: str | None) -> Source:
    with part_of("velodyne", f"reading {path.name}"):
        import dpkt
        import velodyne_decoder
        from velodyne_decoder.util import iter_pcap
    code = None
    try:
        for _, data in iter_pcap(path):
            if isinstance(data, bytes) and len(data) == _PACKET:
                code = data[-1]
                break
    except (ValueError, EOFError, OSError, dpkt.dpkt.Error) as error:
        raise LogError(f"{path}: no .pcap that can be read: {error}") from None
    model = getattr(velodyne_decoder.Model, _VELODYNE.get(code or 0, ""), None)
    if code is None or model is None:
        raise LogError(
            f"{path}: no packets of a Velodyne that is known"
            + (f" (model {code:#x})" if code is not None else "")
            + "; for an Ouster its metadata must lie beside it, named "
            + path.with_suffix(".json").name
        )
    table = Path(imu) if imu else path.with_name("imu.csv")
    return Source(
        name=path.name,
        scans=lambda: _velodyne_scans(path, model),
        inertial=read_inertial(table),
        mounting=read_calib(path.with_name("calib.json")),
        notes=(f"a Velodyne {_VELODYNE[code]}; inertial samples are of {table.name}",),
        time_field="time",
        inertial_name=table.name,
    )


def _velodyne_scans(path: Path, model: Any) -> Iterator[StoredScan]:
    import dpkt
    import velodyne_decoder

    config = velodyne_decoder.Config(model=model)
    config.timestamp_first_packet = True
    try:
        for stamp, rows in velodyne_decoder.read_pcap(path, config, as_pcl_structs=True):
            host = getattr(stamp, "host", stamp)
            points = np.stack([rows[axis].astype(np.float64) for axis in "xyz"], -1)
            yield StoredScan(float(host), points, rows["time"], rows["ring"])
    except (ValueError, EOFError, OSError, RuntimeError, dpkt.dpkt.Error) as error:
        raise LogError(f"{path}: the decoder cannot read it: {error}") from None

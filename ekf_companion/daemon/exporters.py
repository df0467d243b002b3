"""The live estimate for programs that draw it: Foxglove, and PlotJuggler by UDP.

Each runs on a thread of its own and sends the newest estimate: one that is too slow misses some.

Sources: Foxglove SDK for Python; PlotJuggler, plotjuggler_plugins/DataStreamUDP and ParserJSON (the
field ``timestamp``, s).
"""

from __future__ import annotations

import asyncio
import logging
import math
import socket
import threading
import time
from collections.abc import Callable
from email.message import Message
from typing import Any, Protocol

import msgspec
import numpy as np

from ekf_companion.config.service import LiveConfig
from ekf_companion.daemon.access import Refusal, refuse_site
from ekf_companion.daemon.feed import Feed
from ekf_companion.daemon.foxglove_gate import Address, Gate, hidden_host
from ekf_companion.daemon.snapshots import SnapshotSource
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.status.observer import Observer

_log = logging.getLogger(__name__)

NAME = "ekf_companion"
_WAIT = 0.5
_MOST_REFUSED = 8
"""Number of pages whose refusal is logged."""
_PREFIX, _SUFFIX = b'{"live":', b"}"


class Sink(Protocol):
    """Receiver of the estimates."""

    def send(self, live: bytes) -> None:
        """Send an estimate in JSON."""

    def close(self) -> None:
        """End."""


class Exporter:
    """Sends the newest estimate periodically."""

    def __init__(self, name: str, open_sink: Callable[[], Sink | None], feed: Feed) -> None:
        """Start the thread; it calls ``open_sink``, which returns None if it fails."""
        self._open_sink, self._feed = open_sink, feed
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def finish(self) -> None:
        """Send no more; does not wait."""
        self._feed.finish()

    def join(self, end_s: float) -> None:
        """Wait until that is done, or until a time of the monotonic clock, s."""
        self._thread.join(max(end_s - time.monotonic(), 0.0))

    def _run(self) -> None:
        if (sink := self._open_sink()) is None:
            return
        with self._feed.watch() as viewer:
            while viewer is not None and not viewer.is_over:
                for message in viewer.take(_WAIT):
                    live = message.removeprefix(_PREFIX).removesuffix(_SUFFIX)
                    if live != b"null":
                        sink.send(live)
        sink.close()


class UdpSink:
    """Sends JSON in datagrams, with the time in ``timestamp``."""

    def __init__(self, address: str) -> None:
        """Send to ``HOST:PORT``."""
        host, _, port = address.rpartition(":")
        found = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_DGRAM)
        self._address: Any = found[0][4]
        self._socket = socket.socket(found[0][0], socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def send(self, live: bytes) -> None:
        """Send one datagram; without a listener it is lost."""
        data = b'{"timestamp":%.6f,"%s":%s}' % (time.time(), NAME.encode(), live)
        try:
            self._socket.sendto(data, self._address)
        except OSError as error:
            _log.debug("live.udp_json: %s", error)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class FoxgloveSink:
    """Serves Foxglove: all numbers, both positions, and the pose as a transform."""

    def __init__(
        self, foxglove: Any, port: int, refuse: Callable[[Message], Refusal | None]
    ) -> None:
        """Listen on a port of this computer; ``refuse`` says why a request is refused, or None."""
        from foxglove import messages

        self._messages = messages
        # A context of its own: what else in this process logs to Foxglove is not ours
        self._context = foxglove.Context()
        host = hidden_host()
        self._server = foxglove.start_server(
            name="ekf-companion", host=host, port=0, context=self._context
        )
        try:
            self._gate = Gate(port, Address(host, self._server.port), refuse)
        except OSError:
            self._server.stop()
            raise
        self._foxglove = foxglove
        self._channels: dict[str, Any] = {}
        self._frame: LocalFrame | None = None

    def send(self, live: bytes) -> None:
        """Send one estimate on its channels."""
        data: dict[str, Any] = msgspec.json.decode(live)
        other = data["autopilot"]
        self._channel(f"/{NAME}", json=True).log(data)
        self._fix(f"/{NAME}/location", data)
        if other is not None:
            self._fix("/autopilot/location", other)
        self._transform(data)

    def close(self) -> None:
        """End the server."""
        self._gate.close()
        self._server.stop()

    def _channel(self, topic: str, kind: str = "", *, json: bool = False) -> Any:
        if topic not in self._channels:
            if json:
                made = self._foxglove.Channel(topic, context=self._context)
            else:
                from foxglove import channels

                made = getattr(channels, kind)(topic, context=self._context)
            self._channels[topic] = made
        return self._channels[topic]

    def _fix(self, topic: str, data: dict[str, Any]) -> None:
        if data["lat_deg"] is None or data["lon_deg"] is None:
            return
        fix = self._messages.LocationFix(
            latitude=data["lat_deg"], longitude=data["lon_deg"], altitude=data["alt_m"] or 0.0
        )
        self._channel(topic, "LocationFixChannel").log(fix)

    def _transform(self, data: dict[str, Any]) -> None:
        """Send the pose: east, north, up of the first position; forward, left, up of the body."""
        angles = [data[f"{name}_deg"] for name in ("roll", "pitch", "heading")]
        place = [data[name] for name in ("lat_deg", "lon_deg", "alt_m")]
        if None in angles or None in place:
            return
        lat, lon = math.radians(place[0]), math.radians(place[1])
        if self._frame is None:
            self._frame = LocalFrame(lat, lon, place[2])
        north, east, down = self._frame.to_ned(
            np.array([lat]), np.array([lon]), np.array([place[2]])
        )[0].tolist()
        q_nb = so3.from_euler(*map(math.radians, angles))
        w, x, y, z = so3.to_east_north_up(q_nb).tolist()
        self._channel("/tf", "FrameTransformChannel").log(
            self._messages.FrameTransform(
                parent_frame_id="map",
                child_frame_id="base_link",
                translation=self._messages.Vector3(x=east, y=north, z=-down),
                rotation=self._messages.Quaternion(x=x, y=y, z=z, w=w),
            )
        )


def open_exporters(
    config: LiveConfig,
    observer: Observer,
    loop: asyncio.AbstractEventLoop,
    names: frozenset[str] = frozenset(),
) -> list[Exporter]:
    """Start the configured exporters; ``names`` are this computer's, beside localhost."""
    source = SnapshotSource(observer, loop)
    feed = Feed(lambda _: {"live": source.read_live()})
    exporters = []
    if address := config.udp_json:
        exporters.append(Exporter("udp-json", lambda: _open_udp(address), feed))
    if config.foxglove_port:
        exporters.append(Exporter("foxglove", lambda: _open_foxglove(config, names), feed))
    return exporters


def _open_udp(address: str) -> Sink | None:
    try:
        return UdpSink(address)
    except OSError as error:
        _log.warning("live.udp_json: %s: %s; flying without it", address, error)
        return None


def _open_foxglove(config: LiveConfig, names: frozenset[str]) -> Sink | None:
    port, refused = config.foxglove_port, set[str]()

    def refuse(headers: Message) -> Refusal | None:
        refusal = refuse_site(headers, names, config.foxglove_origins, is_socket=True)
        if refusal is not None and len(refused) < _MOST_REFUSED:
            who = f"{headers.get('Origin')!r:.80} by the name {headers.get('Host')!r:.80}"
            if who not in refused:
                refused.add(who)
                _log.warning("live.foxglove_port: refused a page of %s: see foxglove_origins", who)
        return refusal

    try:
        import foxglove
    except ImportError:
        _log.warning(
            "live.foxglove_port: needs the Foxglove SDK: install ekf-companion with the extra: "
            "foxglove; flying without it"
        )
        return None
    try:
        sink = FoxgloveSink(foxglove, port, refuse)
    except Exception as error:  # noqa: BLE001  # the library names no type for a port that is taken
        _log.warning("live.foxglove_port: %d: %s; flying without it", port, error)
        return None
    _log.info("Foxglove on ws://127.0.0.1:%d", port)
    return sink

"""The fake autopilot connected to the doctor without a socket; faults are put in between."""

from dataclasses import replace

from ekf_companion.config.config import Config
from ekf_companion.doctor.collector import EvidenceCollector
from ekf_companion.doctor.diagnosis import diagnose
from ekf_companion.doctor.evidence import Means, Opening
from ekf_companion.doctor.stage import Stage
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.encode import SET_MESSAGE_INTERVAL
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from sim_autopilot.autopilot import Autopilot, Kind
from sim_autopilot.config import GnssConfig, ImuConfig, SimConfig
from sim_autopilot.firmware import parse
from sim_autopilot.flight import Flight

LINK_MS = 1_000_000
"""Each way, ns."""
UDP = Opening(url="udpin:0.0.0.0:14540", kind="udpin")

_PARTS = ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")
ARDUPILOT_OURS = {
    "VISO_TYPE": 1,
    "EK3_SRC_OPTIONS": 0,
    **{f"EK3_SRC1_{part}": 6 for part in _PARTS},
    **{f"EK3_SRC{k}_{part}": 0 for k in (2, 3) for part in _PARTS},
}
"""All that decides, so that ours alone counts."""


def evidence_of(**known):
    """Return the evidence of a link on which nothing has come, but what is given."""
    return replace(EvidenceCollector(Config(), Means.LIVE).evidence(0), **known)


def simulated(rate=100.0, **options):
    return SimConfig(imu=ImuConfig(rate=rate), gnss=GnssConfig(rate=5.0), **options)


def examine(
    sim=None,
    kind=Kind.PX4,
    *,
    config=None,
    means=Means.LIVE,
    signing=None,
    begin_ns=0,
    seconds=8.0,
    scenario="hover",
    change=None,
    hears=lambda name, fields: True,
    aside=lambda t_ns: (),
    personality=None,
    opening=UDP,
):
    """Return the evidence of a conversation.

    Args:
        signing: Ours.
        begin_ns: Our clock where the autopilot's is 0.
        change: Takes the name and fields (a dict) of what the autopilot sends, and gives name and
            fields, changed, or None: it is lost.
        hears: Whether the autopilot hears a message of ours, by its name and fields.
        personality: Of the autopilot, with its habits; goes before ``kind``.
        opening: What came of opening the link; a recording has none.
        aside: Further frames that somebody else sends, at each turn.
    """
    sim = sim or simulated()
    config = config or Config()
    if personality is not None:
        personality = parse(personality)
        sim = personality.suited(sim)
    autopilot = Autopilot(sim, personality or kind)
    collector = EvidenceCollector(config, means, signing)
    wire, sender = Splitter(), Sender(sim.system_id, 1)
    ours = Splitter()
    now_ns = begin_ns
    for cycle in Flight.plan(scenario, sim, duration=seconds).cycles():
        now_ns = begin_ns + cycle.t_ns
        autopilot.cycle(cycle)
        data = b"".join(autopilot.data_to_send())
        if change is not None:
            data = b"".join(changed(wire.feed(data), change, sender))
        data += b"".join(aside(cycle.t_ns))
        if data:
            collector.receive(data, now_ns + LINK_MS)
        collector.tick(now_ns + LINK_MS)
        for frame in ours.feed(b"".join(collector.data_to_send(now_ns + LINK_MS))):
            if hears(LAYOUTS[frame.message_id].name, unpack(frame)):
                autopilot.receive(frame.raw, cycle.t_ns + 2 * LINK_MS)
    return collector.evidence(
        now_ns + 2 * LINK_MS, opening if means is not Means.RECORDING else None
    )


def changed(frames, change, sender):
    """Return frames anew, each as ``change`` leaves it; the numbers count what was lost too."""
    for frame in frames:
        said = change(LAYOUTS[frame.message_id].name, unpack(frame)._asdict())
        if said is None:
            sender.sequence = (sender.sequence + 1) & 0xFF
        elif isinstance(said, bytes):
            yield said
        else:
            yield sender.message(said[0], **said[1])


def without(*names):
    """Return a change that loses these messages, and leaves no gap in the numbers."""
    return lambda name, fields: b"" if name in names else (name, fields)


def with_fields(message, **values):
    """Return a change that sets fields of one message; a function makes a value of the old one."""

    def change(name, fields):
        if name == message:
            for field, value in values.items():
                fields[field] = value(fields[field]) if callable(value) else value
        return name, fields

    return change


def thinned(**kept):
    """Return a change that lets one in so many of a message through, leaving no gap."""
    seen = dict.fromkeys(kept, 0)

    def change(name, fields):
        if name in kept:
            seen[name] += 1
            if seen[name] % kept[name]:
                return b""
        return name, fields

    return change


def is_request(name, fields):
    """Whether a message of ours asks for a stream."""
    return name == "COMMAND_LONG" and fields.command == SET_MESSAGE_INTERVAL


def stage(evidence, which):
    """Return the result of one stage."""
    return next(result for result in diagnose(evidence) if result.stage is Stage(which))


def words(result):
    """Return all that a result says."""
    return " ".join([result.saw, *(f"{t.cause} {t.remedy}" for t in result.problems)])


HEARTBEAT = IDS["HEARTBEAT"]

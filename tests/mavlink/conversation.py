"""Voices on one link: an autopilot, a ground station, somebody else, and a session among them."""

from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import LAYOUTS
from ekf_companion.mavlink.session import Session, SessionOptions

MS = 1_000_000
SECOND = 1000 * MS
ARDUPILOT, PX4 = 3, 12
OURS = (1, 194)


class Voice:
    """Somebody on the link."""

    def __init__(self, system_id=1, component_id=1, family=PX4):
        self.sender = Sender(system_id, component_id)
        self.family = family

    def say(self, name, **fields):
        return self.sender.message(name, **fields)

    def heartbeat(self, **fields):
        return self.say("HEARTBEAT", **({"type": 2, "autopilot": self.family} | fields))

    def place(self, t_ms=1000):
        """Return the messages on its origin, and on where it takes the vehicle to be."""
        origin = {"latitude": 458366240, "longitude": 85943670, "altitude": 489_400}
        here = {"lat": 458366240, "lon": 85943670, "alt": 489_400, "time_boot_ms": t_ms}
        return self.say("GPS_GLOBAL_ORIGIN", **origin) + self.say("GLOBAL_POSITION_INT", **here)

    def to_us(self, name, **fields):
        return self.say(name, **({"target_system": 1, "target_component": 194} | fields))


def station():
    return Voice(255, 190)


def met(family=PX4, **options):
    """Return a session that has just found its autopilot, and the autopilot."""
    session = Session(SessionOptions(**({"rates": {}} | options)))
    autopilot = Voice(family=family)
    session.receive(autopilot.heartbeat(), 0)
    session.events()
    session.data_to_send()
    return session, autopilot


def sent(session, *names):
    """Return what the session sends, as fields: all, or of some messages only."""
    messages = [unpack(frame) for frame in Splitter().feed(b"".join(session.data_to_send()))]
    return [m for m in messages if not names or type(m).__name__ in names]


def asked(message):
    """Return the name of the message that a command asks for."""
    return LAYOUTS[int(message.param1)].name

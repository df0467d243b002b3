"""Bytes and times in, measurements out, and back: MAVLink without a socket and without a clock.

messages  how each message lies on the wire, taken from pymavlink's definitions
frame     bytes to frames
codec     payloads to named fields and back, messages of ours to frames
decode    wire units to measurements, whatever the habits of the two autopilots
encode    estimates to payloads
timebase  the autopilot's clock from its messages' stamps
dejitter  stamps taken when a message was sent, corrected to when its sample was taken
sequence  what was lost, by the frames' numbers
reader    the frames that come most often, to the same bits: live one, of a log many
payload   what is in these, to rows
clock     the autopilot's clock compared with ours: TIMESYNC both ways
outbox    messages of ours on their way out, and the record of all that went in and out
admission, signing        which frames are let in
guard, fusion, decision   whether the autopilot may get our ODOMETRY
session   the conversation with one autopilot: admits frames and routes them to its services

A service (service.Service) is one conversation of the protocol. It sends through the outbox and
emits events:
discovery  which autopilot it is     heartbeat   our identity, and others under our ids
request    what we request           audit       rates that come   clock       TIMESYNC
commands   what is requested of us   parameters  what may be set   statustext  texts for the pilot
guard      which parameters decide
delivery   how late ODOMETRY arrives (lag: round trips; pacing: how many the line takes)
second_source  others who send the autopilot poses (reset_counter: what ours bears beside them)

Some modules are compiled (core.memory.signatures names them); the same files run as plain Python.
"""

from ekf_companion.errors import is_compiled

is_compiled("ekf_companion.mavlink.reader")

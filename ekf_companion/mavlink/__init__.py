"""Bytes and times in, measurements out, and back: MAVLink without a socket and without a clock.

layout    how each message lies on the wire, taken from pymavlink's definitions
frame     bytes to frames and back
codec     payloads to named fields and back
decode    wire units to measurements, with every trap of the two autopilots
encode    estimates to payloads
timebase  one time base out of several stamps, that nothing wild can move
dejitter  stamps of sending, brought back to when the sample was taken
clock     two clocks compared: TIMESYNC both ways
admission, signing      who may speak at all
fusion, guard, label    what an autopilot would do with our ODOMETRY
session   the conversation with one autopilot: asks who may speak, and routes to its services

A service (service.Service) is one conversation of the protocol, sends by the outbox, and says what
happened as an event:
discovery who the autopilot is    heartbeat who we are    clash      who else says that he is us
request   what we ask for         audit     what comes    timesync   whose clock says what
commands  what is asked of us     guard     what is sent  parameters what may be turned
statustext what the pilot hears
"""

"""Bytes and times in, measurements out, and back: MAVLink without a socket and without a clock.

layout    how each message lies on the wire, taken from pymavlink's definitions
frame     bytes to frames and back
codec     payloads to named fields and back
decode    wire units to measurements, with every trap of the two autopilots
encode    estimates to payloads
clock     one time base out of several stamps; TIMESYNC both ways
session   the conversation with one autopilot: routes what comes to its services

A service (service.Service) is one conversation of the protocol, sends by the outbox, and says what
happened as an event:
discovery who the autopilot is       heartbeat who we are           request   what we ask of it
timesync  whose clock says what      sequence  what the link lost
"""

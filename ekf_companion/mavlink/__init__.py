"""Bytes and times in, measurements out, and back: MAVLink without a socket and without a clock.

layout    how each message lies on the wire, taken from pymavlink's definitions
frame     bytes to frames and back
codec     payloads to named fields and back
decode    wire units to measurements, with every trap of the two autopilots
encode    estimates to payloads
timebase  one time base out of several stamps, that nothing wild can move
dejitter  stamps of sending, brought back to when the sample was taken
clock     two clocks compared: TIMESYNC both ways
session   the peer: who it is, what we asked of it, what we owe it
"""

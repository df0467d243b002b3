"""Failures on the wire, in the sensors and of the clock, at set times, from one seed.

fault    a fault, its kinds, and its syntax
wire     frames in, frames out, with their times
sensors  cycles in, cycles out
clock    the autopilot's clock against the world's: reboots, jumps and skew
"""

"""What goes wrong: on the wire, in the sensors and with the clock, at set times, from one seed.

Rooms
    fault    a fault, the kinds that there are, and how one is written
    wire     frames in, frames out, with their times
    sensors  cycles in, cycles out
    clock    the autopilot's clock against the world's: reboots, jumps and skew
"""

"""Flies the autopilots' own simulators with the daemon beside them, and scores what they fly on.

simulator   PX4's and ArduPilot's simulators as processes
companion   the daemon as a process: started, killed, configured
pilot       a ground station: arms, flies paths, switches parameters, shifts the receiver
mission     what is uploaded for AUTO
second      another companion, which sends positions of its own
throttle    a slow or bad line between the autopilot and the daemon
flight      one flight: its processes, and what is noted; lock: one at a time
place       places on the Earth, and each autopilot's projection
recording   what the daemon sent, and what it only recorded
tracks      truth, the autopilot's own estimate and ours, from the logs
score       errors of one against the other, silence, steps, the vehicle's true motion
line        lines of the table, floors, and the dangers of every flight

What is flown, and the lines of each: basic, starts, links, sources, faults, wings.
"""

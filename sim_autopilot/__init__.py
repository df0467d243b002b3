"""A fake autopilot: flies a known motion, speaks MAVLink, and scores the estimate that comes back.

It is independent of what it tests: it shares the vocabulary (``nav``) and the wire (``mavlink``,
``link``), and no code of the estimator.

truth       a motion as a function of time, with exact derivatives
scenarios   the motions that can be flown
config      every number of the simulation
sensors     the sensors' samples of a motion, from one seed
flight      all of it in order of time, one cycle of the autopilot's loop at a time
events      the same as the estimator's events, without the wire
telemetry   the fields of each message for a cycle
personality, firmware   the real autopilots' habits, and the autopilots that have them
habits, rates, parameters   parts of the imitation: the sensors as the firmware reports
            them, the streams, the parameter service
autopilot   the MAVLink peer: bytes and times in, bytes out
acceptance  what either autopilot does with an ODOMETRY it receives (judgement, px4_receiver,
            ardupilot_receiver)
faults      failures on the wire, in the sensors and of the clock
spec        the syntax of a personality and a fault
rig         the autopilot with its faults
follower    a filter that fuses ODOMETRY as the autopilots' own do; flown asks how it flies on it
loop        a rig and a companion in one process, faster than real time
score       the estimate against the truth; score_table prints it
episodes    the effect of each fault on the estimate, and the time of recovery
recording   files: truth as CSV, frames as .tlog
replay      a recorded flight as frames at their times
component   another computer on the link, with faults: vision says where the vehicle is, ranging
            how far from anchors
lidar       a simulated lidar with its inertial sensor, in a room of its own
figure      the figure of a flight
fly, demo, __main__   the shells, which alone open, await, sleep and print
"""

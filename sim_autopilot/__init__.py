"""A fake autopilot: flies a known motion, speaks MAVLink, and scores the estimate that comes back.

An independent witness: it shares the vocabulary (``nav``) and the wire (``mavlink``, ``link``) with
what it tests, and none of the estimator.

Rooms
    truth      a motion as a function of time, with exact derivatives
    scenarios  the motions that can be flown
    config     every number that can be turned
    sensors    what the sensors say of the motion, from one seed
    flight     all of it laid out in order of time, one cycle of the autopilot's loop at a time
    events     the same as the estimator's events, without the wire
    telemetry  what each message says of a cycle
    personality, firmware   whom it passes for: the habits, and the traps, of the real ones
    habits, rates, parameters, reception   what it says of its sensors, how often, and what it takes
    autopilot  the MAVLink peer: bytes and times in, bytes out
    acceptance what either autopilot would do with an ODOMETRY (judgement, px4_receiver,
               ardupilot_receiver)
    faults     what goes wrong: on the wire, in the sensors, with the clock
    spec       how a personality and a fault are written
    rig        the autopilot with everything that goes wrong around it
    loop       a rig and a companion on one bench, faster than real time
    score      the estimate against the truth
    episodes   what a fault did to the estimate, and when that was over
    recording  files: truth as CSV, frames as .tlog
    replay     a recorded flight as frames at their times
    figure     the picture of a flight
    pace, fly, demo, __main__   the shells, which alone open, await, sleep and print
"""

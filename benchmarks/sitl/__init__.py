"""Flies the autopilots' own simulators with the daemon beside them, and scores what they fly on.

simulator   PX4's and ArduCopter's simulator as processes
companion   the daemon as a process: started, killed, configured
pilot       a ground station: arms, flies paths, switches parameters, turns the receiver off
flights     what is flown, and what each flight must show
tracks      truth, the autopilot's own estimate and ours, from the logs
score       errors of one against the other, and the lag
"""

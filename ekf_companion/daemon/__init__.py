"""The service: one event loop with its link, threads for its files and its HTTP port, and systemd.

In flight, only code in this room opens, awaits, sleeps and reads clocks; it has no equation and no
MAVLink field.
"""

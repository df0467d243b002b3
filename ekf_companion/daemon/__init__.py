"""The shells of the service: one event loop, its link, its files, its HTTP port, systemd.

Only here is opened, awaited, slept and asked what time it is while flying; no equation and no
MAVLink field.
"""

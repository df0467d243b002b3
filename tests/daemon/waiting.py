"""Waiting for what happens, with limits that a busy machine keeps too."""

import time

LIMIT = 300.0
"""Seconds, for a loaded machine: what takes 5 s on an idle one takes 60 times as long at worst,
with thirty others on two cores. Nothing waits so long that goes well."""


def wait_until(condition, seconds=LIMIT):
    """Wait until something is so, and return it."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end
        time.sleep(0.002)
    return found


def close(*parts, seconds=LIMIT):
    """End the threads of parts of the daemon."""
    for part in parts:
        part.finish()
    end = time.monotonic() + seconds
    for part in parts:
        part.join(end)

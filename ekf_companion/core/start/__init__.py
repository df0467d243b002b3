"""The way into flight: levelling, north by motion, the first fix, resets and reboots.

What happens in every step of a running filter is of ``order``.
"""

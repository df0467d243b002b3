"""Recorded flights, one file per format: columns first, objects never in the loop.

What looks at every byte is compiled ahead of time, like the kernel: the files named ``*_search``.
"""

from ekf_companion.errors import is_compiled

is_compiled("ekf_companion.logs.tlog_search")

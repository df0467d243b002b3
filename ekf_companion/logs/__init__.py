"""Recorded flights, one file per format: columns first, no object per sample.

Loops over every byte are compiled ahead of time, like the kernel: the files named ``*_search``.
"""

from ekf_companion.errors import is_compiled

is_compiled("ekf_companion.logs.tlog_search")

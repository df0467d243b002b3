"""Logs in, estimates out: the daemon's companion over a recording.

Reads through ``logs``, estimates through ``engine``; scores and figures are ``analysis``.
"""

"""Who is wrong, and by how much: gates, learnt noise, and sources compared with each other.

It judges observations and innovations; what a sensor should read is of ``aids``.
"""

"""Errors of the estimate: the tables of docs/accuracy.

``__main__`` compares recorded flights with a truth or with the autopilot. Many simulated flights:

consistency      NEES, and NIS of each aid
outages          drift without GNSS, and whether sigma covers it
four_imus        the same for four units on one real quadrotor
receiver_faults  a receiver that is wrong
compassless      flight without a compass, or with a wrong one
seed             the flight of the seed article
"""

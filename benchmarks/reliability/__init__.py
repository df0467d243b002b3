"""Recovery from faults and damage.

soak       hours of flight with every fault, in memory (soak_flight, soak_score), and a minute of
           the daemon in real time (soak_daemon)
fuzz       random and mutated bytes and messages; guided: directed by coverage, with Atheris
damaged    files with 300 kinds of damage each, read by the commands (damage, whole_files)
endurance  10^8 inertial samples
"""

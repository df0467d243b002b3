"""What the project measures of itself; none of it is a test.

speed        how long things take on this machine: ``make bench``
accuracy     errors of the estimate, the tables of docs/accuracy: ``make accuracy``
filters      the other filters compared, the tables of docs/FILTERS.md: ``make filters``
reliability  recovery from faults, the tables of docs/RELIABILITY.md: ``make soak``, ``make fuzz``,
             ``make endurance``
truth        whether the status ok is right, by flights of an independent generator: ``make truth``
sensitivity  the effect of 30 % of each constant of a kernel's file on these: ``make sensitivity``
trace        how many files, moves and calls one frame goes through, queued ODOMETRY included
bits         whether a change has altered a bit of any result of a revision: ``make bits``

Shared by these: ``recorded`` (the recorded flights), ``campaign`` (many simulated ones and their
errors), ``matched`` (the settings of their sensors), ``document`` (tables between marks), ``tree``
(other revisions, built).
"""

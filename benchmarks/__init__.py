"""What the project measures of itself; none of it is a test.

speed        how long things take on this machine: ``make bench``
accuracy     how good the estimate is, the tables of docs/ACCURACY.md: ``make accuracy``
filters      how the other filters compare, the tables of docs/FILTERS.md: ``make filters``
reliability  what it withstands, the tables of docs/RELIABILITY.md: ``make soak``, ``make fuzz``,
             ``make endurance``
truth        whether what is called ok is, by flights of an independent generator: ``make truth``
sensitivity  what 30 % of each constant of a kernel's file does to these: ``make sensitivity``
trace        how many files, moves and calls one frame goes through, queued ODOMETRY included
bits         whether a change has altered a bit of any result of a revision: ``make bits``

Shared by these: ``recorded`` (the recorded flights), ``campaign`` (many simulated ones and their
errors), ``matched`` (the settings of their sensors), ``document`` (tables between marks), ``tree``
(other revisions, built).
"""

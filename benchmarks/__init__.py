"""What the project measures of itself; none of it is a test.

speed        how long things take on this machine: ``make bench``
accuracy     how good the estimate is, the tables of docs/ACCURACY.md: ``make accuracy``
filters      how the other filters compare, the tables of docs/FILTERS.md: ``make filters``
reliability  what it withstands, the tables of docs/RELIABILITY.md: ``make soak``, ``make fuzz``,
             ``make endurance``
bits         whether a refactoring has changed a bit of any result: ``make bits``

Shared by these: ``recorded`` (the recorded flights), ``campaign`` (many simulated ones and their
errors), ``matched`` (the settings of their sensors), ``document`` (tables between marks).
"""

"""Whether a change has altered a bit of any result: ``make bits BASE=REVISION``."""

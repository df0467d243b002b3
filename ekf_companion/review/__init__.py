"""What a log is good for: whether its sensors agree, and how far its estimate can be trusted.

It looks at what ``replay`` reads and estimates, and changes none of it; scores and figures are
``analysis``.
"""

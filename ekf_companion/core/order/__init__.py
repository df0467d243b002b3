"""One order of events: the timeline, and the step that takes a sample and what came before it.

``step`` leads; each kind of event has a file that judges, fuses and counts it.
"""

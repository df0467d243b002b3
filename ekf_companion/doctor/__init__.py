"""The doctor: which stage loses the data, and which parameter to change.

The stages: the link opens; bytes come; they are frames, with right checksums, from our autopilot,
of the messages that are needed, often enough, on one clock, with plausible values; an estimate is
made of them, sent, and fused by the autopilot. ``examination`` listens to a link or reads a
recording, and returns the :class:`~.evidence.Evidence`; :func:`~.diagnosis.diagnose` judges it
stage by stage, without link and clock.
"""

from __future__ import annotations

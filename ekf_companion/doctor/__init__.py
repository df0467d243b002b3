"""The doctor: which stage of the way loses the data, and which parameter to change.

The way: the link opens, bytes come, they are frames, rightly summed, of our autopilot, of the
messages that are needed, often enough, on one clock, of values that can be meant; an estimate is
made of them, sent, and taken by the autopilot. An :class:`~.examination.Examination` listens to a
link or to a recording and gives :class:`~.evidence.Evidence`; :func:`~.diagnosis.diagnose` judges
it stage by stage, and knows neither link nor clock.
"""

from __future__ import annotations

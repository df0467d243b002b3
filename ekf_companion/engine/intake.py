"""What the measurements of one vehicle are given to."""

from __future__ import annotations

from typing import Protocol

from ekf_companion.config.config import Config
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.pipeline import Estimate, Pipeline
from ekf_companion.nav.measurements import Row


class Intake(Protocol):
    """Takes the measurements of one vehicle: its pipeline, or what collects them for it."""

    def process_row(self, row: Row) -> Estimate | None:
        """Take a measurement; return an estimate if it is the newest sample, and processed."""

    def retune(self, settings: FilterSettings) -> None:
        """Go on with other settings."""


def open_live(config: Config, family: str) -> tuple[Pipeline, Intake]:
    """Return a pipeline that processes each measurement at once."""
    pipeline = Pipeline(config, family)
    return pipeline, pipeline

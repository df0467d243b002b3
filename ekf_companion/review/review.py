"""A run over a log, and the report on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

from ekf_companion.config.config import Config
from ekf_companion.core.settings.from_settings import delays_ns
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.logs.recording import Recording
from ekf_companion.logs.source import suffix_of
from ekf_companion.nav.measurements import Kind
from ekf_companion.replay.log_source import reference, truth
from ekf_companion.replay.pose_aid import PoseFile, open_with
from ekf_companion.replay.run import Progress, Run
from ekf_companion.replay.worker import Block, Mode
from ekf_companion.review import left_out, stamps
from ekf_companion.review.magnetometer import MagnetometerCheck
from ekf_companion.review.receivers import ReceiverCheck
from ekf_companion.review.report import Report, add_block, note_shortcomings

if TYPE_CHECKING:
    from ekf_companion.review.agreement import AgreementCheck

P = TypeVar("P", bound=Pipeline)


class Review(Generic[P]):
    """Looks at each block of a run, and reports on the whole."""

    def __init__(
        self,
        path: Path,
        config: Config,
        kind: Callable[..., P],
        mode: Mode = Mode.BLOCKS,
        aid: PoseFile | None = None,
    ) -> None:
        """Open a log.

        Arguments and errors are as for :class:`ekf_companion.replay.run.Run`, and of ``aid``, poses
        of another estimator, as for :func:`ekf_companion.replay.pose_aid.open_with`.
        """
        opened = None
        if aid is not None:
            opened, config = open_with(path, config, aid)
        self.run = Run(path, config, kind, mode, opened)
        self.config = config
        """The configuration that is used: what the poses state of themselves is in it."""
        self._path = path
        log = self.run.log
        self._report = Report(log=str(path), damage=log.damage)
        if isinstance(log, Recording) and any(log.extent_ns):
            self._report.extent.widen(*log.extent_ns)
        self._magnetometer = MagnetometerCheck(config.heading.year)
        self._receivers = ReceiverCheck()
        self._agreement: AgreementCheck | None = None
        self._faults: list[str] = []
        self._doubts: list[str] = []
        # Columns and units of a table are declared by its user, those of the others by programs
        if suffix_of(path) == ".csv":
            from ekf_companion.review.agreement import AgreementCheck

            self._agreement = AgreementCheck(config.gnss.delay)

    def blocks(self, progress: Progress | None = None) -> Iterator[Block]:
        """Process the log, look at each block, and yield it."""
        for block in self.run.blocks(progress):
            self._add(block)
            yield block

    def messages(self, progress: Progress | None = None) -> Iterator[tuple[int, bytes]]:
        """Process the log, and yield frames with their stamps (us), as the daemon sends them."""
        return self.run.messages(self._add, progress)

    def _add(self, block: Block) -> None:
        add_block(self._report, block.events, block.table)
        self._magnetometer.add(block.events, block.table)
        if not isinstance(self.run.log, Recording):
            self._receivers.add(block.events)
        if self._agreement is not None:
            self._agreement.add(block.events)

    def compare_sensors(self) -> None:
        """Judge whether the sensors of a table contradict each other, before :meth:`finish` does.

        What was kept for it, which is large, is let go.
        """
        if self._agreement is not None:
            self._faults, self._doubts = self._agreement.found()
            self._agreement = None

    def finish(self) -> Report:
        """Return the report on the whole log.

        Raises:
            LogError: Nothing could be estimated from it.
        """
        run, report = self.run, self._report
        report.family, report.notes = run.family, list(run.notes)
        report.refused, report.lost_share = run.refused, run.lost_share
        report.elsewhere = run.elsewhere
        if run.pipelines:
            report.health = health = run.pipelines[-1].health()
            late = delays_ns(self.config, run.family, run.gnss_delay)
            resets = sum(one.resets - one.reboots for one in run.pipelines)
            report.other_resets = resets - (health.resets - report.reboots)
            report.last_reset = next(
                (one.reset_reason for one in reversed(run.pipelines) if one.resets > one.reboots),
                "",
            )
            report.fix_delay = float(late[Kind.GNSS]) * 1e-9 + health.gnss_delay
            report.fix_delay -= health.velocity_lag
        self._note_left_out()
        report.notes += self._magnetometer.notes() + self._receivers.notes()
        self.compare_sensors()
        report.is_contradictory = bool(self._faults)
        report.notes += self._faults + self._doubts
        report.faults = [fault for one in run.pipelines for fault in one.found_faults()]
        report.notes += [f"fault: {one.words(report.extent.first_ns)}" for one in report.faults]
        note_shortcomings(report, self._path)
        report.own = reference(run.log, run.autopilot)
        report.truth = truth(run.log, run.autopilot)
        return report

    def _note_left_out(self) -> None:
        """Note what was left out, by the screen or by the readers of messages."""
        report, log = self._report, self.run.log
        if isinstance(log, Recording):
            report.left_out = left_out.of_columns(self.run.screen)
            report.stamps = stamps.of_columns(self.run.screen, log.lost_share)
        else:
            report.left_out = list(left_out.of_telemetry(report.refused, report.counts))
            share = log.back / max(len(log), 1)
            report.stamps = stamps.of_telemetry(report.refused, report.counts, share)
        if report.health is not None:
            total = report.counts[Kind.GNSS]
            report.left_out += left_out.of_frozen(report.health, report.flagged, total)
        if report.estimates and report.stamps.total:
            used = report.estimates / report.stamps.total
            report.stamps = report.stamps._replace(unused_share=max(1.0 - used, 0.0))
        report.notes += [one.note for one in report.left_out]

"""A run over a fleet: logs in, a data set out; what is there already is not done again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial

from ekf_companion.analysis.flight_review import changed_settings, review
from ekf_companion.config.config import Config
from ekf_companion.errors import CompanionError
from ekf_companion.fleet import dataset
from ekf_companion.fleet.build import build_name, fingerprint
from ekf_companion.fleet.dataset import Partition
from ekf_companion.fleet.executor import Executor, Lost, largest_first
from ekf_companion.fleet.listing import Listing
from ekf_companion.fleet.observations import events, histograms
from ekf_companion.fleet.remote import CHANGES
from ekf_companion.fleet.row import failed, failed_of, row_of
from ekf_companion.fleet.run import Progress
from ekf_companion.fleet.source import Source, content_of
from ekf_companion.logs.recording import counted

SHOWN = 4
"""Logs that could not be read which are named."""


@dataclass(slots=True)
class Account:
    """How a run ended."""

    outcomes: Counter[str] = field(default_factory=Counter)
    """Of the logs of this run."""
    before: int = 0
    """Logs that were done before."""
    unread: list[str] = field(default_factory=list)
    """Why, of the first."""

    def lines(self) -> list[str]:
        """Return the account in words."""
        total = sum(self.outcomes.values()) + self.before
        words = [f"{count} {outcome}" for outcome, count in sorted(self.outcomes.items())]
        if self.before:
            words.append(f"{self.before} done before")
        found = [f"{counted(total, 'log')}: {', '.join(words)}", *self.unread]
        if (more := self.outcomes["unread"] - len(self.unread)) > 0:
            found.append(f"and {more} more that could not be read; the next run reads them")
        return found


def partition_of(place: str, config: Config) -> Partition:
    """Return where this build's results with a configuration are."""
    settings = "; ".join(f"{key} = {value}" for key, value in changed_settings(config).items())
    return Partition(place, build_name(), fingerprint(config), settings)


def run(
    listing: Listing,
    config: Config,
    place: str,
    executor: Executor,
    progress: Progress | None = None,
) -> Account:
    """Estimate from all logs that are not in the data set yet.

    Neither logs nor results are held: of each that is done, a mark of 64 bits is.

    Raises:
        ConfigError: A name is nothing that is there.
        LogError: The data set cannot be read or written.
    """
    into = partition_of(place, config)
    done, account = dataset.marks(into), Account()
    weight = total = 0
    for source in listing:
        total += source.weight
        if source.mark in done:
            account.before += 1
            weight += source.weight
    if progress is not None:
        progress(weight, total)
    left: Iterator[Source] = (source for source in listing if source.mark not in done)
    task = partial(store, config=config, into=into)
    for source, found in executor.run(task, largest_first(left, lambda one: one.weight)):
        if isinstance(found, Lost):
            dataset.write_log(into, failed(source.name, found.why), source.mark, "")
            account.outcomes["failed"] += 1
        else:
            outcome, why = found
            account.outcomes[outcome] += 1
            if outcome == "unread" and len(account.unread) < SHOWN:
                account.unread.append(f"{source.name}: {why}")
        weight += source.weight
        if progress is not None:
            progress(weight, total)
    for _ in executor.run(partial(_pack, into=into), dataset.loose(into)):
        pass
    return account


def store(source: Source, config: Config, into: Partition) -> tuple[str, str]:
    """Estimate from a log, write its parts, and return its outcome, and why it was not read."""
    try:
        with source.opened() as path:
            content = content_of(path)
            if dataset.is_written(into, source.name, source.mark, content):
                return "done before", ""
            try:
                flight = review(path, config)
            except CompanionError as error:
                row, found = failed_of(error, path, source.name), None
            else:
                row, found = row_of(source.name, flight), flight
            if content_of(path) != content:
                return "unread", CHANGES
            row |= dict(source.about)
            parts = () if found is None else (tuple(events(found)), tuple(histograms(found)))
            dataset.write_log(into, row, source.mark, content, *parts)
            return str(row["outcome"]), ""
    except CompanionError as error:
        return "unread", str(failed_of(error, None, source.name)["why"])


def _pack(names: list[str], into: Partition) -> str:
    try:
        dataset.pack(names, into)
    except CompanionError as error:
        return str(error)
    return ""

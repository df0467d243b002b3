"""Turn what is stored into what the filter takes, by what the recording as a whole shows."""

from __future__ import annotations

from dataclasses import replace

from ekf_companion.errors import LogError
from ekf_companion.lidar.readers.doppler import compare_doppler
from ekf_companion.lidar.readers.inertial import decide_inertial
from ekf_companion.lidar.readers.motion import compare_motion
from ekf_companion.lidar.readers.point_cloud import DOPPLERS
from ekf_companion.lidar.readers.scans import Scans
from ekf_companion.lidar.readers.source import Source
from ekf_companion.lidar.readers.survey import survey
from ekf_companion.lidar.readers.timing import decide_timing
from ekf_companion.lidar.recording import InertialSamples, Mounting, Recording


def judge(
    source: Source,
    mounting: Mounting | None,
    stamp: str | None,
    by_doppler: bool | None = None,
    most_speed: float = 0.0,
) -> Recording:
    """Return the recording of a source, with every decision in a sentence.

    Args:
        source: The opened recording.
        mounting: The lidar on the inertial sensor; None: as the recording says.
        stamp: `start`, `middle` or `end` of a scan, of which the stamps are; None: to be decided.
        by_doppler: Whether radial speeds count; None: where any is not 0.
        most_speed: Radial speed at which they wrap, m/s; 0: they do not.

    Raises:
        LogError: Nothing can be estimated from it, or its lidar and its inertial samples
            contradict each other.
    """
    inertial, about_inertial = decide_inertial(source)
    found = survey(source)
    by_doppler = found.has_doppler and found.has_speed if by_doppler is None else by_doppler
    if by_doppler and not found.has_doppler:
        raise LogError(
            f"{source.name}: not all points have radial speeds (a field {', '.join(DOPPLERS)}): "
            "this is no radar's recording, or its driver leaves them out"
        )
    timing, order, about_times = decide_timing(source, found, stamp, by_doppler=by_doppler)
    stamps = found.stamp[order] * timing.stamp_unit
    about_clocks = _compare_clocks(source, stamps[0], stamps[-1] + timing.period, inertial)
    known = mounting or source.mounting
    if by_doppler:
        scans = Scans(source, timing, order)
        shown = compare_doppler(scans, inertial, known, most_speed)
        return Recording(
            name=source.name,
            scans=replace(scans, timing=shown.timing),
            inertial=inertial,
            mounting=shown.mounting,
            decisions=(
                *source.notes,
                *source.faults,
                *about_times,
                *about_inertial,
                *about_clocks,
                *shown.sentences,
            ),
            by_doppler=True,
            doppler_noise=shown.noise,
        )
    about_mounting = (
        []
        if known
        else [
            "the recording does not say how the lidar is mounted: taken as at the inertial sensor, "
            "axes alike; give the mounting if it is known"
        ]
    )
    chosen = known or Mounting()
    scans = Scans(source, timing, order)
    timing, about_motion = compare_motion(scans, stamps, inertial, chosen, stamp is None)
    return Recording(
        name=source.name,
        scans=replace(scans, timing=timing),
        inertial=inertial,
        mounting=chosen,
        decisions=(
            *source.notes,
            *source.faults,
            *about_times,
            *about_inertial,
            *about_clocks,
            *about_mounting,
            *about_motion,
        ),
    )


def _compare_clocks(
    source: Source, first: float, last: float, inertial: InertialSamples
) -> list[str]:
    """Return a sentence about scans without inertial samples.

    Raises:
        LogError: The two do not overlap.
    """
    begin, end = float(inertial.stamp[0]), float(inertial.stamp[-1])
    both = min(last, end) - max(first, begin)
    if both <= 0:
        raise LogError(
            f"{source.name}: scans are stamped {first:.3f} to {last:.3f} s and inertial samples "
            f"{begin:.3f} to {end:.3f} s: they share no time; stamp both by one clock (PTP, or the "
            "time of arrival in both drivers)"
        )
    missing = (last - first) - both
    if missing > 2 * (last - first) / 100:
        return [f"{missing:.1f} s of scans lie before or after the inertial samples"]
    return []

"""Statistics of demonstrations of any origin."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from minidual.demos.data.source import DataEpisode, DataSource
from minidual.demos.lerobot_features import state_names
from minidual.demos.quality import CELL_M, grip_changes, tcp_positions
from minidual.errors import NothingEvaluatedError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import GRIPPERS_N, Array

_STARTS = "start_x_y_yaw"
"""Fact of an episode: place [m] and yaw [rad] of the carried object, at the start."""


class EntryStats(NamedTuple):
    """One entry of states, over all episodes.

    Attributes:
        speed_max: Largest change a second.
        effort_peak: Largest measured torque or current, NaN without one.
    """

    name: str
    low: float
    high: float
    mean: float
    std: float
    speed_max: float
    effort_peak: float


class DataStats(NamedTuple):
    """All episodes.

    Attributes:
        durations_s: Least, median and most.
        successes_n: None where no source records it.
        cells_n: 5 cm cubes that the hands visit, None for other arms.
        force_peaks_n: Largest recorded force by name.
        starts: Range (low, high) of x [m], y [m] and yaw [rad] of the object at the start.
    """

    kind: str
    episodes_n: int
    unreadable_n: int
    ticks_n: int
    rates_hz: tuple[float, ...]
    tasks: tuple[str, ...]
    cameras: dict[str, tuple[int, int]]
    durations_s: tuple[float, float, float]
    successes_n: int | None
    switches_per_episode: float
    cells_n: int | None
    force_peaks_n: dict[str, float]
    starts: tuple[tuple[float, float], ...]
    entries: tuple[EntryStats, ...]


def data_stats(
    source: DataSource, kinematics: Kinematics
) -> tuple[DataStats, list[dict[str, Any]]]:
    """Return the numbers of all episodes, and a flat row for each.

    Args:
        source: Demonstrations.
        kinematics: Of the arms here; hands are followed only where the joints are theirs.

    Raises:
        NothingEvaluatedError: No episode can be read.
    """
    readings = list(source.episodes())
    episodes = [
        reading.episode
        for reading in readings
        if reading.episode is not None and len(reading.episode)
    ]
    if not episodes:
        raise NothingEvaluatedError(
            f"none of {len(readings)} episodes in {source.root} can be read",
            remedy=f"minidual data check {source.root}",
        )
    hands = [_hand_cells(episode, kinematics) for episode in episodes]
    durations_s = np.array([episode.duration_s for episode in episodes])
    successes = [episode.success for episode in episodes if episode.success is not None]
    switches = [_switches(episode) for episode in episodes]
    stats = DataStats(
        kind=source.kind,
        episodes_n=len(episodes),
        unreadable_n=len(readings) - len(episodes),
        ticks_n=sum(map(len, episodes)),
        rates_hz=tuple(sorted({episode.rate_hz for episode in episodes})),
        tasks=tuple(sorted({episode.task for episode in episodes if episode.task})),
        cameras=dict(episodes[0].cameras),
        durations_s=(durations_s.min(), float(np.median(durations_s)), durations_s.max()),
        successes_n=sum(successes) if successes else None,
        switches_per_episode=float(np.mean(switches)),
        cells_n=_union(hands),
        force_peaks_n=_force_peaks_n(episodes),
        starts=_start_ranges(episodes),
        entries=_entries(episodes),
    )
    rows = [
        _row(episode, cells, switches_n)
        for episode, cells, switches_n in zip(episodes, hands, switches, strict=True)
    ]
    return stats, rows


def stats_lines(stats: DataStats) -> list[str]:
    """Return the numbers for people, without the table of entries."""
    shortest, median, longest = stats.durations_s
    pictures = [f"{name} {size[0]} x {size[1]}" for name, size in stats.cameras.items()]
    lines = [
        f"{stats.kind}: {stats.episodes_n} episodes, {stats.ticks_n} ticks",
        f"rate: {', '.join(f'{rate:g}' for rate in stats.rates_hz)} Hz",
        f"duration: {shortest:.1f} to {longest:.1f} s, median {median:.1f} s",
        f"cameras: {', '.join(pictures) or 'none'}",
        f"gripper switches per episode: {stats.switches_per_episode:.1f}",
    ]
    if stats.unreadable_n:
        lines.append(f"unreadable: {stats.unreadable_n} episodes (minidual data check names why)")
    if stats.tasks:
        lines.append(f"instructions: {'; '.join(stats.tasks[:3])}")
    if stats.successes_n is not None:
        lines.append(f"recorded as a success: {stats.successes_n} of {stats.episodes_n}")
    if stats.cells_n is not None:
        lines.append(f"coverage: the hands visit {stats.cells_n} cubes of {100 * CELL_M:.0f} cm")
    if stats.force_peaks_n:
        peaks = [f"{name} {peak:.1f} N" for name, peak in stats.force_peaks_n.items()]
        lines.append(f"force peaks: {', '.join(peaks)}")
    if stats.starts:
        x, y, yaw = stats.starts
        lines.append(
            f"starts of the object: x {x[0]:.3f} to {x[1]:.3f} m, y {y[0]:.3f} to {y[1]:.3f} m, "
            f"yaw {yaw[0]:.2f} to {yaw[1]:.2f} rad",
        )
    return lines


def entry_rows(stats: DataStats) -> list[dict[str, str]]:
    """Return the table of entries for people."""
    rows: list[dict[str, str]] = []
    for entry in stats.entries:
        row = {
            "entry": entry.name,
            "least": f"{entry.low:.3f}",
            "most": f"{entry.high:.3f}",
            "std": f"{entry.std:.3f}",
            "fastest a second": f"{entry.speed_max:.2f}",
        }
        peak = entry.effort_peak
        row["effort peak"] = "not recorded" if np.isnan(peak) else f"{peak:.1f}"
        rows.append(row)
    return rows


def _entries(episodes: Sequence[DataEpisode]) -> tuple[EntryStats, ...]:
    names = episodes[0].state_names
    alike = [episode for episode in episodes if episode.state_names == names]
    states = np.vstack([episode.state for episode in alike])
    speeds = np.vstack(
        [np.abs(np.diff(e.state, axis=0)).max(axis=0, initial=0.0) * e.rate_hz for e in alike],
    )
    efforts = [episode.effort for episode in alike if episode.effort is not None]
    peaks = np.full(len(names), np.nan)
    if efforts:
        measured = np.abs(np.vstack(efforts)).max(axis=0)
        peaks[: min(len(measured), len(names))] = measured[: len(names)]
    return tuple(
        EntryStats(
            name=name,
            low=float(states[:, k].min()),
            high=float(states[:, k].max()),
            mean=float(states[:, k].mean()),
            std=float(states[:, k].std()),
            speed_max=float(speeds[:, k].max()),
            effort_peak=float(peaks[k]),
        )
        for k, name in enumerate(names)
    )


def _hand_cells(episode: DataEpisode, kinematics: Kinematics) -> set[tuple[int, ...]] | None:
    """Return the cubes that the hands visit, None for other arms."""
    robot = kinematics.robot
    if episode.state_names != state_names(robot):
        return None
    hands = tcp_positions(episode.state[:, : episode.state.shape[1] - GRIPPERS_N], kinematics)
    cells = np.floor(hands.reshape(-1, 3) / CELL_M).astype(int)
    return set(map(tuple, cells.tolist()))


def _union(hands: Sequence[set[tuple[int, ...]] | None]) -> int | None:
    own_cells = [cells for cells in hands if cells is not None]
    return len(set().union(*own_cells)) if own_cells else None


def _force_peaks_n(episodes: Sequence[DataEpisode]) -> dict[str, float]:
    peaks: dict[str, float] = {}
    for episode in episodes:
        for name, values in episode.forces.items():
            peaks[name] = max(peaks.get(name, 0.0), float(values.max()))
    return peaks


def _switches(episode: DataEpisode) -> int:
    columns = [k for k, name in enumerate(episode.action_names) if "gripper" in name.casefold()]
    return sum(len(grip_changes(episode.action[:, k])) for k in columns)


def _start_ranges(episodes: Sequence[DataEpisode]) -> tuple[tuple[float, float], ...]:
    recorded = [_start(episode.facts) for episode in episodes]
    starts = np.array([start for start in recorded if start is not None])
    if not len(starts):
        return ()
    lows = starts.min(axis=0).tolist()
    highs = starts.max(axis=0).tolist()
    return tuple(zip(lows, highs, strict=True))


def _start(facts: Mapping[str, Any]) -> Array | None:
    start = facts.get(_STARTS)
    if not isinstance(start, list) or len(start) != 3:
        return None
    return np.array(start, dtype=float)


def _row(
    episode: DataEpisode,
    cells: set[tuple[int, ...]] | None,
    switches_n: int,
) -> dict[str, Any]:
    row: dict[str, Any] = {
        "episode": episode.name,
        "ticks": len(episode),
        "duration_s": round(episode.duration_s, 3),
        "success": "" if episode.success is None else episode.success,
        "gripper_switches": switches_n,
        "cells": "" if cells is None else len(cells),
        "effort_peak": "",
        "force_peak_n": "",
        "task": episode.task,
    }
    if episode.effort is not None:
        row["effort_peak"] = round(float(np.abs(episode.effort).max()), 3)
    if episode.forces:
        largest_n = max(float(values.max()) for values in episode.forces.values())
        row["force_peak_n"] = round(largest_n, 3)
    return row

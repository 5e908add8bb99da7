"""One offline page of demonstrations: films, signals and faults."""

import base64
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import jinja2
import numpy as np

from minidual.demos.data.check import Finding
from minidual.demos.data.source import DataEpisode, DataSource, Image
from minidual.plant.render import write_video
from minidual.robot.pair import SIDES

_POINTS_MAX = 400
"""Points of a drawn signal."""
_DIGITS = 5
_PLOT_ENTRIES_MAX = 8
"""Signals in one plot."""
_PAGES = jinja2.Environment(
    loader=jinja2.PackageLoader("minidual.show.episodes"),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


class ShownEpisode(NamedTuple):
    """One episode on the page.

    Attributes:
        films: Data URI by camera.
        plots: JSON of each plot.
        faults: In words.
    """

    name: str
    title: str
    films: dict[str, str]
    plots: list[dict[str, Any]]
    faults: list[str]


def write_page(
    source: DataSource,
    numbers: Sequence[int],
    findings: Sequence[Finding],
    lines: Sequence[str],
    path: Path,
) -> None:
    """Write a page of the episodes with these numbers.

    Args:
        source: Demonstrations.
        numbers: Of episodes that can be read.
        findings: Faults of all episodes.
        lines: What is said of all episodes.
        path: Of the page.
    """
    films = _films(source, numbers)
    shown: list[ShownEpisode] = []
    for number, reading in enumerate(source.episodes()):
        if number in numbers and reading.episode is not None:
            faults = [str(each.fault) for each in findings if each.episode == reading.name]
            shown.append(_shown(reading.episode, films.get(number, {}), faults))
    page = _PAGES.get_template("page.html.j2").render(
        title=str(source.root),
        lines=list(lines),
        episodes=shown,
        findings=[(each.episode, str(each.fault)) for each in findings],
    )
    path.write_text(page, encoding="utf-8")


def _shown(
    episode: DataEpisode,
    films: Mapping[str, str],
    faults: Sequence[str],
) -> ShownEpisode:
    parts = [f"{len(episode)} ticks", f"{episode.duration_s:.1f} s", f"{episode.rate_hz:g} Hz"]
    if episode.success is not None:
        parts.append("success" if episode.success else "no success")
    if episode.task:
        parts.append(episode.task)
    return ShownEpisode(episode.name, ", ".join(parts), dict(films), plots(episode), list(faults))


def plots(episode: DataEpisode) -> list[dict[str, Any]]:
    """Return the plots of an episode, each with at most eight entries of one arm.

    Actions are drawn dashed over the states of the same name.
    """
    every = max(1, -(-len(episode) // _POINTS_MAX))
    times = _numbers(episode.times_s[::every])
    commanded = {name: episode.action[:, k] for k, name in enumerate(episode.action_names)}
    drawn: list[dict[str, Any]] = []
    for group in _groups(episode.state_names):
        lines: list[dict[str, Any]] = []
        for k in group:
            name = episode.state_names[k]
            line = {"name": name, "y": _numbers(episode.state[::every, k])}
            if name in commanded:
                line["command"] = _numbers(commanded[name][::every])
            lines.append(line)
        drawn.append({"title": "state, and command dashed", "t": times, "lines": lines})
    unmatched = [name for name in episode.action_names if name not in episode.state_names]
    for group in _groups(unmatched):
        names = [unmatched[k] for k in group]
        lines = [{"name": name, "y": _numbers(commanded[name][::every])} for name in names]
        drawn.append({"title": "action", "t": times, "lines": lines})
    if episode.forces:
        lines = [{"name": n, "y": _numbers(f[::every])} for n, f in episode.forces.items()]
        drawn.append({"title": "forces [N]", "t": times, "lines": lines})
    if episode.effort is not None:
        joints = episode.state_names[: episode.effort.shape[1]]
        if len(joints) < episode.effort.shape[1]:
            joints = tuple(f"effort {k}" for k in range(episode.effort.shape[1]))
        for group in _groups(joints):
            lines = [{"name": joints[k], "y": _numbers(episode.effort[::every, k])} for k in group]
            drawn.append({"title": "effort", "t": times, "lines": lines})
    return drawn


def _groups(names: Sequence[str]) -> list[list[int]]:
    """Return the entries of each plot: of one arm, at most eight."""
    groups: list[list[int]] = []
    last_side = ""
    for k, name in enumerate(names):
        side = name.replace(".", "_").partition("_")[0]
        is_same = side == last_side or side not in SIDES
        if not groups or not is_same or len(groups[-1]) == _PLOT_ENTRIES_MAX:
            groups.append([])
        groups[-1].append(k)
        last_side = side
    return groups


def _films(source: DataSource, numbers: Sequence[int]) -> dict[int, dict[str, str]]:
    """Return a film of each camera and episode, as a data URI."""
    rates = {
        number: reading.episode.rate_hz
        for number, reading in enumerate(source.episodes())
        if number in numbers and reading.episode is not None
    }
    films: dict[int, dict[str, str]] = {number: {} for number in rates}
    for camera in source.cameras():
        missing = set(rates)
        for number, images in source.pictures(camera):
            if number in missing:
                films[number][camera] = film_uri(images, rates[number])
                missing.remove(number)
            if not missing:
                break
    return films


def film_uri(images: Image, rate_hz: float) -> str:
    """Return pictures (T, H, W, 3) as an H.264 film that every browser plays."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        write_video(path, (_even(image) for image in images), fps=max(1, round(rate_hz)))
        content = base64.b64encode(path.read_bytes()).decode("ascii")
    return f"data:video/mp4;base64,{content}"


def _even(image: Image) -> Image:
    """Return an image with an even number of rows and columns, as 4:2:0 needs."""
    height, width = image.shape[:2]
    size = (width + width % 2, height + height % 2)
    if size == (width, height):
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_NEAREST), dtype=np.uint8)


def _numbers(values: np.ndarray) -> list[float]:
    """Return finite numbers with five digits; others as 0, which a fault names."""
    finite = np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
    return [float(f"{value:.{_DIGITS}g}") for value in finite]

"""Figures are functions of data: they draw what they are given, for any number of joints."""

import dataclasses
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread
from matplotlib.text import Text

from minidual.config.root import Config
from minidual.plant.world import World
from minidual.robot.pair import robot_from
from minidual.show.figures import canvas
from minidual.show.figures.film import Postures, draw_failures, film_postures, sheet_of_postures
from minidual.show.figures.film_model import film_model
from minidual.show.figures.trial import draw_trial
from minidual.show.report.figures import LOOKS
from minidual.tasks.failures import failure_words
from minidual.trials.benchmark import draw_under
from minidual.trials.measures import TrialLog
from minidual.trials.methods import MethodInputs
from minidual.trials.runner import Bench


@pytest.mark.parametrize(("arm", "joints"), [("panda", 7), ("ur5", 6)])
def test_a_trial_is_drawn_with_the_joints_of_its_arm(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arm: str,
    joints: int,
) -> None:
    config = Config.model_validate({"robot": {"arm": arm}})
    robot = robot_from(config.robot)
    t = np.linspace(0.0, 2.0, 50)
    zeros = np.zeros((50, robot.dof))
    tau = np.tile(0.5 * robot.tau_max, (50, 1))
    tau[:, -1] = 0.9 * robot.tau_max[-1]
    log = TrialLog(
        t,
        zeros,
        tau,
        np.zeros((50, 2, 3)),
        np.zeros((50, 3)),
        0.0 * t,
        np.ones((50, 2)),
        0.0 * t,
        t > 1.0,
    )
    drawn: list[Any] = []
    make = canvas.new_figure
    monkeypatch.setattr(
        "minidual.show.figures.trial.new_figure",
        lambda *a, **k: drawn.append(make(*a, **k)) or drawn[0],
    )
    draw_trial(
        log,
        config.scene,
        robot,
        tmp_path / "trial.svg",
        goal=np.array([0.53, -0.28, 0.01]),
        title="a title",
    )
    svg = (tmp_path / "trial.svg").read_text(encoding="utf-8")
    assert ">a title</text>" in svg
    assert svg.count("<path") > 20
    goals = [line.get_ydata()[0] for line in drawn[0][1][0, 0].lines if line.get_linestyle() == ":"]
    assert goals == [0.53, -0.28, 0.01]  # of this trial, not the middle of its range
    torque = drawn[0][1][1, 1]
    assert [text.get_text() for text in torque.get_legend().get_texts()] == [
        f"joint {i + 1}" for i in range(joints)
    ]
    assert torque.lines[joints - 1].get_ydata()[0] == pytest.approx(0.9)  # the larger of both arms
    assert torque.lines[0].get_ydata()[0] == pytest.approx(0.5)


def test_the_same_plot_gives_the_same_bytes_without_a_date(tmp_path: Path) -> None:
    written: list[bytes] = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        figure, axes = canvas.new_figure(1, 1, 4.0, 3.0)
        axes[0, 0].plot([0.0, 1.0], [1.0, 0.0])
        canvas.save_plot(figure, tmp_path / folder / "plot.svg")
        written.append((tmp_path / folder / "plot.svg").read_bytes())
    assert written[0] == written[1]
    assert b"<dc:date>" not in written[0]


def test_lines_and_markers_are_told_apart_without_colour() -> None:
    """Printed in grey, neither two lines of a plot nor two methods of the report look the same."""
    assert len({str(style) for _, style in canvas.LINES}) == len(canvas.LINES) >= 7
    assert len({look.marker for look in LOOKS}) == len(LOOKS) >= 6
    greys = [np.dot(to_rgb(look.colour), (0.299, 0.587, 0.114)) for look in LOOKS]
    assert min(abs(one - next_one) for one, next_one in pairwise(greys)) > 0.08


def test_a_sheet_and_a_film_show_the_postures_that_were_kept(tmp_path: Path) -> None:

    scene = Config().scene
    world = World(scene)
    keep = Postures(0.001)
    model = film_model(scene)
    for _ in range(3):
        world.step()
        keep(world)
    assert len(keep.times) == 3
    assert sheet_of_postures(model, keep, tmp_path / "sheet.png", frames=2) == 2
    picture = imread(tmp_path / "sheet.png")
    half = picture.shape[1] // 2
    assert picture[40:, :half].std() > 0.05
    assert picture[40:, half:].std() > 0.05
    assert film_postures(model, keep.qpos, tmp_path / "film.mp4") == 3


def test_a_long_title_does_not_run_into_the_next_image(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    figures: list[Any] = []
    make = canvas.new_figure

    def keep(*size: Any) -> Any:
        figures.append(make(*size))
        return figures[-1]

    monkeypatch.setattr(canvas, "new_figure", keep)
    long = "object let go in the air, or moved after its release, at 18.66 s"
    image = np.zeros((30, 40, 3), np.uint8)
    canvas.sheet([(long, image), (long, image)], 2, tmp_path / "sheet.png")
    _, axes = figures[0]
    for axis in axes.flat:
        (title,) = [text for text in axis.findobj(Text) if text.get_text().split() == long.split()]
        assert title.get_window_extent().x1 <= axis.get_window_extent().x1


def test_a_failed_trial_is_drawn_before_as_and_after_it_failed(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """`hold` never lifts the rod, so every trial of it fails; the condition is that of the trial."""
    inputs = MethodInputs(Config(), 7)
    trial = draw_under(inputs, "object colour")
    result, _ = Bench("hold", inputs, "object colour").run(trial(3))
    assert not result.success
    drawn: list[tuple[str, Any]] = []
    write = canvas.sheet

    def keep(images: Any, columns: int, path: Path) -> None:
        drawn.extend(images)
        write(images, columns, path)

    monkeypatch.setattr("minidual.show.figures.film.sheet", keep)
    draw_failures([(inputs, trial(3), result)], tmp_path / "failures.png")
    titles = [title for title, _ in drawn]
    assert titles == [
        "hold, object colour, trial 3",
        f"{failure_words(result.failure)}, at {result.failed_at_s:.2f} s",
        result.reason,
    ]
    assert all(picture.std() > 20.0 for _, picture in drawn)
    assert imread(tmp_path / "failures.png").std() > 0.02
    draw_failures(
        [(inputs, trial(3), dataclasses.replace(result, condition="clean"))],
        tmp_path / "clean.png",
    )
    for k in (0, 2):  # the last one, too, though the trial has ended by then
        difference = np.abs(drawn[k][1].astype(float) - drawn[k + 3][1]).max()
        assert difference > 30.0, "the rod has the colour of its trial"


def test_a_picture_that_cannot_be_finished_leaves_the_older_one(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = tmp_path / "plan.png"
    grey = np.full((8, 8, 3), 128, dtype=np.uint8)
    canvas.sheet([("first", grey)], 1, path)
    older = path.read_bytes()

    def fails_half_way(self: object, target: Path, **options: object) -> None:
        Path(target).write_bytes(b"half")
        raise OSError("no space left")

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", fails_half_way)
    with pytest.raises(OSError, match="no space left"):
        canvas.sheet([("second", grey)], 1, path)
    assert path.read_bytes() == older
    assert [p.name for p in tmp_path.iterdir()] == ["plan.png"]

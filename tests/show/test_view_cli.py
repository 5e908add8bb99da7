"""Asking for a view: the options, what they change (one worker), and what they must not (the verdict)."""

import json
from pathlib import Path
from typing import Any

import pytest

from minidual.cli.app import run_command_line
from minidual.config.loader import load_config
from minidual.config.root import Config
from minidual.errors import ExitCode
from minidual.gate.runner import Runner
from minidual.gate.store import RunStore
from minidual.gate.table import StageEntry, StageTable
from minidual.plant.world import World
from minidual.show.view.panel import Panel
from minidual.stages import scene_view
from minidual.stages.registry import STAGES, TOOLS
from minidual.tasks.catalogue import TASKS, make_task
from tests.support.browser import unused_port
from tests.support.pipeline_toys import Toy

MOVES_ARMS = {"env-check", "plan", "carry", "teleop-record", "deploy", "benchmark"}


def _table(toy: Toy, *, watchable: bool = True) -> StageTable:
    return StageTable((StageEntry(toy.name, toy, (), "A toy", watchable=watchable),))


def test_every_stage_that_moves_the_arms_can_be_watched_and_no_other() -> None:
    assert {entry.name for entry in STAGES.values() if entry.watchable} == MOVES_ARMS
    assert next(t for t in TOOLS if t.name == "view").view_default == "web"


def test_a_view_is_handed_on_and_leaves_the_fingerprint_as_it_is(tmp_path: Path) -> None:
    contexts: list[Any] = []

    class Seen(Toy):
        def run(self, context: Any) -> Any:
            contexts.append(context)
            return super().run(context)

    toy = Seen("alpha")
    loaded = load_config("smoke", [])
    verdicts = []
    for name, view in (("plain", None), ("watched", object())):
        runner = Runner(_table(toy), RunStore(tmp_path, name), loaded, view=view)
        verdicts.append(runner.run("alpha").verdict)
        assert contexts[-1].view is view
    assert [c.workers for c in contexts] == [loaded.config.workers, 1]
    assert loaded.config.workers > 1
    plain, watched = verdicts
    assert plain.fingerprint == watched.fingerprint
    assert plain.options == watched.options == {}
    assert plain.overrides == watched.overrides == ()
    assert [c.to_json() for c in plain.checks] == [c.to_json() for c in watched.checks]
    # What was watched counts for one who does not watch: it is passing and fresh.
    assert not Runner(_table(toy), RunStore(tmp_path, "watched"), loaded).run("alpha").ran


def test_wrong_words_are_refused_before_anything_runs(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    table = _table(Toy("alpha"))
    common = ["--profile", "smoke", "--runs-dir", str(tmp_path)]
    for words, code, said in (
        (["--view", "wbe"], ExitCode.USAGE, "did you mean 'web'?"),
        (
            ["--view-port", "9000"],
            ExitCode.USAGE,
            "--view-port goes with --view web, not with --view none",
        ),
        (["--view", "web", "--view-port", "99999"], ExitCode.USAGE, "view.port"),
        (["--view", "web", "--view-host", "203.0.113.7"], ExitCode.USAGE, "cannot bind interface"),
    ):
        assert run_command_line(["alpha", *words, *common], table) == code
        assert said in capsys.readouterr().err
    assert not (tmp_path / "smoke" / "alpha").exists()
    assert run_command_line(["alpha", "--view", "none", *common], table) == ExitCode.PASS


def test_a_command_that_moves_nothing_takes_no_view(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    table = _table(Toy("alpha"), watchable=False)
    arguments = ["alpha", "--view", "web", "--profile", "smoke", "--runs-dir", str(tmp_path)]
    assert run_command_line(arguments, table) == ExitCode.USAGE
    assert "--view" in capsys.readouterr().err


def test_a_fresh_stage_has_nothing_to_show_and_says_so(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = ["alpha", "--profile", "smoke", "--runs-dir", str(tmp_path)]
    assert run_command_line(arguments, _table(Toy("alpha"))) == ExitCode.PASS
    capsys.readouterr()
    watched = [*arguments, "--view", "web", "--view-port", str(unused_port()), "--json"]
    assert run_command_line(watched, _table(Toy("alpha"))) == ExitCode.PASS
    shown = capsys.readouterr()
    assert "nothing to watch: alpha is passing and fresh; --force runs it again" in shown.err
    assert json.loads(shown.out)["ran"] is False


def test_the_scene_shows_itself_for_the_time_asked_for(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    common = ["--runs-dir", str(tmp_path), "--view-port", str(unused_port())]
    assert (
        run_command_line(["view", "--for-s", "0.6", "--json", *common], STAGES, TOOLS)
        == ExitCode.PASS
    )
    shown = capsys.readouterr()
    document = json.loads(shown.out)
    assert document["url"].startswith("http://127.0.0.1:")
    assert f"view: {document['url']}" in shown.err
    assert 0.6 <= document["wall_s"] < 5.0
    assert 0.0 < document["simulated_s"] <= document["wall_s"] + 0.05  # never faster than life
    for words, said in (
        (["--for-s", "-1"], "--for-s is -1"),
        (["--view", "none"], "--view-port goes with"),
    ):
        assert run_command_line(["view", *words, *common], STAGES, TOOLS) == ExitCode.USAGE
        err = capsys.readouterr().err
        assert said in err
        assert "http" not in err  # no address of what is refused
    assert run_command_line(["view", "--view", "none"], STAGES, TOOLS) == ExitCode.USAGE
    assert "needs a view" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())  # a tool that only shows writes nothing


@pytest.mark.parametrize("name", TASKS)
def test_the_scene_of_every_task_is_shown(
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shown: list[World] = []

    def world(*given: Any) -> World:
        shown.append(World(*given))
        return shown[-1]

    monkeypatch.setattr(scene_view, "World", world)
    words = [
        "view",
        "--task",
        name,
        "--for-s",
        "0.1",
        "--runs-dir",
        str(tmp_path),
        "--view-port",
        str(unused_port()),
    ]
    assert run_command_line(words, STAGES, TOOLS) == ExitCode.PASS
    (scene,) = shown
    assert scene.time > 0.0
    assert set(scene.objects) == set(make_task(Config(task=name)).objects)


def test_another_task_can_be_chosen_on_the_page(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shown: list[World] = []

    def world(*given: Any) -> World:
        shown.append(World(*given))
        return shown[-1]

    monkeypatch.setattr(scene_view, "World", world)
    monkeypatch.setattr(Panel, "choice", "pot_lift")
    words = ["view", "--for-s", "0.3", "--runs-dir", str(tmp_path)]
    port = ["--view-port", str(unused_port())]
    assert run_command_line([*words, *port], STAGES, TOOLS) == ExitCode.PASS
    assert [tuple(each.objects) for each in shown] == [("rod",), ("pot",)]
    assert shown[-1].time > 0.0


def test_an_aside_that_shows_nothing_refuses_a_view(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = ["carry", "--tune", "--view", "web", "--runs-dir", str(tmp_path)]
    assert run_command_line(arguments, STAGES, TOOLS) == ExitCode.USAGE
    assert "--view goes with --perturb of carry, not with --tune" in capsys.readouterr().err

"""The tasks as a benchmark of vla-eval, run by its own runner."""

from __future__ import annotations

import asyncio
import tomllib
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import yaml

from minidual.errors import UsageError
from minidual.tasks.catalogue import TASKS
from tests.support.documents import ROOT
from tests.support.late import late

runner = late("vla_eval.runners.sync_runner")
specs = late("vla_eval.specs")

PLUGIN = ROOT / "plugins" / "vla_eval_minidual"
SMALL = {"scene.camera.width_px": 64, "scene.task.time_limit_s": 2.0}


@pytest.fixture(autouse=True)
def on_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(PLUGIN))


def benchmark_of(**options: Any) -> Any:
    from vla_eval_minidual import MinidualBenchmark

    return MinidualBenchmark(**options)


class Server:
    """A model server in this process: it stays where the arms are, with open hands."""

    def __init__(self) -> None:
        self.seen: list[dict[str, Any]] = []
        self.ended: list[dict[str, Any]] = []

    async def start_episode(self, payload: dict[str, Any]) -> None:
        assert payload["task"]["suite"] == "minidual"

    async def act(self, observation: dict[str, Any]) -> dict[str, Any]:
        self.seen.append(observation)
        return {"actions": np.r_[observation["states"][:-2], 1.0, 1.0]}

    async def end_episode(self, result: dict[str, Any]) -> None:
        self.ended.append(result)


def run(benchmark: Any, server: Any, **task: Any) -> dict[str, Any]:
    episode = runner.SyncEpisodeRunner().run_episode(benchmark, task, server)
    return asyncio.run(episode)


def test_its_runner_plays_an_episode_to_the_tasks_own_time_limit() -> None:
    benchmark = benchmark_of(tasks=["pot_lift"], views=["high", "right"], settings=SMALL)
    server = Server()
    (task,) = benchmark.get_tasks()
    try:
        result = run(benchmark, server, **task, episode_idx=0)
    finally:
        benchmark.cleanup()
    assert result["steps"] == 100
    assert result["metrics"] == {"success": False, "time_s": pytest.approx(2.0)}
    assert server.ended == [result]
    first = server.seen[0]
    assert first["task_description"]
    assert {name: image.shape for name, image in first["images"].items()} == {
        "cam_high": (96, 64, 3),
        "cam_right": (96, 64, 3),
    }


def test_what_it_declares_is_what_it_gives() -> None:
    benchmark = benchmark_of(tasks=["rod_carry"], settings=SMALL)
    try:
        asyncio.run(benchmark.start_episode({"name": "rod_carry", "episode_idx": 3}))
        observation = asyncio.run(benchmark.get_observation())
        declared = benchmark.get_observation_spec()
        assert set(declared) == {"state", "language", *observation["images"]}
        assert declared["state"].validate(observation["states"]) == []
        assert declared["state"].dims == len(observation["states"])
        action = benchmark.get_action_spec()
        assert sum(spec.dims for spec in action.values()) == benchmark.get_metadata()["action_dim"]
        assert list(benchmark.get_hold_action(None)["actions"]) == list(observation["states"])
    finally:
        benchmark.cleanup()


def test_episodes_have_starts_of_their_own_that_can_be_repeated() -> None:
    benchmark = benchmark_of(tasks=["rod_carry"], settings=SMALL)
    try:
        pictures = [
            benchmark.make_obs(benchmark.reset({"name": "rod_carry", "episode_idx": k}), {})
            for k in (0, 1, 0)
        ]
    finally:
        benchmark.cleanup()
    first, second, again = (picture["images"]["cam_high"] for picture in pictures)
    assert np.array_equal(first, again)
    assert not np.array_equal(first, second)


@pytest.mark.parametrize("actions", [np.zeros(15), np.full(16, np.nan), np.zeros((2, 16))])
def test_an_action_that_cannot_be_driven_is_refused(actions: npt.NDArray[np.float64]) -> None:
    benchmark = benchmark_of(tasks=["rod_carry"], views=[], settings=SMALL)
    try:
        benchmark.reset({"name": "rod_carry"})
        with pytest.raises(ValueError, match="16 finite numbers"):
            benchmark.step({"actions": actions})
    finally:
        benchmark.cleanup()


def test_all_tasks_are_there_and_no_other() -> None:
    assert [task["name"] for task in benchmark_of().get_tasks()] == list(TASKS)
    with pytest.raises(UsageError, match="no task 'rod'"):
        benchmark_of(tasks=["rod"])


def test_the_file_for_its_command_names_what_exists() -> None:
    document = yaml.safe_load((PLUGIN / "minidual.yaml").read_text(encoding="utf-8"))
    (entry,) = document["benchmarks"]
    assert entry["benchmark"] == "vla_eval_minidual:MinidualBenchmark"
    assert len(benchmark_of(**entry["params"]).get_tasks()) == 5
    project = tomllib.loads((PLUGIN / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["name"] == PLUGIN.name

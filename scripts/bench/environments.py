"""Steps a second of the environments, beside bare physics of the same states in the same run."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from functools import partial

import mujoco
import numpy as np

from minidual.config.root import Config, changed
from minidual.environments.batched import TICK_S, BatchedEnv
from minidual.environments.scripted import LiftScript
from minidual.environments.task_env import TaskEnv
from minidual.show.report.bench import BenchRow, BenchTable
from scripts.bench.tables import BenchInputs

BARE_RATIO_MAX = 2.0
"""A control step of the largest batch over its bare physics: the goal."""
_WORLDS = (1, 16, 64)
_STEPS_EACH = 5
"""Control steps of 20 ms of one action at 10 Hz."""
_NOTES = (
    "a control step is 20 ms of one world; all numbers a second of processor time, one thread",
    "scripted lifts, from the start on: contacts are solved in about half of the steps",
    "bare: mj_step alone, from the same states with the same commands",
    "fast: 2 ms a step and impratio 10, for learning; trials have 1 ms and 100",
)


def measure(inputs: BenchInputs) -> BenchTable:
    """Time scripted lifts in batches of several sizes, and the single environment."""
    rows: list[BenchRow] = []
    for fast, worlds_n in itertools.product((False, True), _WORLDS):
        name = f"{worlds_n} worlds{', fast' if fast else ''}"
        rows.append(_batched(inputs, name, worlds_n, fast))
        inputs.advance(name)
    rows.append(_single(inputs))
    inputs.advance("single")
    columns = ("steps_per_s", "bare_per_s", "ratio")
    return BenchTable("Environments: control steps a second", columns, tuple(rows), _NOTES)


def _batched(inputs: BenchInputs, name: str, worlds_n: int, fast: bool) -> BenchRow:
    """Time actions of the script, and physics alone from the states that they lead through."""
    env = BatchedEnv(worlds_n, _config(inputs), fast=fast, purpose="bench", supervised=False)
    script = LiftScript(env)
    env.reset()
    env.step(script.action())  # compiled parts load here
    actions_n = max(10, inputs.repeats_n // worlds_n)
    model = env.worlds.model
    own_s = 0.0
    bare_s = 0.0
    for _ in range(actions_n):
        data = env.worlds.data(0)  # a world before the action: physics alone goes on from there
        began_s = time.process_time()
        _, _, terminated, truncated, _ = env.step(script.action())
        script.restart(terminated | truncated)
        own_s += time.process_time() - began_s
        steps_n = round(_STEPS_EACH * TICK_S / env.worlds.dt)
        bare_s += worlds_n * _timed(partial(mujoco.mj_step, model, data), steps_n)
    control_n = actions_n * _STEPS_EACH * worlds_n
    limits = {"ratio": BARE_RATIO_MAX} if worlds_n == max(_WORLDS) else {}
    return _row(name, control_n, own_s, bare_s, limits)


def _single(inputs: BenchInputs) -> BenchRow:
    """Time the environment of one world, with arms at rest, and physics alone."""
    config = _config(inputs)
    env = TaskEnv(config.scene, task=config.task)
    env.reset(seed=0)
    action = env.action_space.sample()
    action[:] = np.r_[env._world.q, 1.0, 1.0]
    env.step(action)
    control_n = max(10, inputs.repeats_n // 4)
    own_s = _timed(lambda: env.step(action), control_n)
    model = env._world.model
    data = mujoco.MjData(model)
    substeps = round(TICK_S / env._world.dt)
    bare_s = _timed(lambda: mujoco.mj_step(model, data), control_n * substeps)
    return _row("single, at rest", control_n, own_s, bare_s, {})


def _config(inputs: BenchInputs) -> Config:
    return changed(inputs.config, {"task": "pot_lift"})


def _timed(call: Callable[[], object], times_n: int) -> float:
    """Return the processor time [s] of some calls."""
    began_s = time.process_time()
    for _ in range(times_n):
        call()
    return time.process_time() - began_s


def _row(
    name: str, control_n: int, own_s: float, bare_s: float, limits: dict[str, float]
) -> BenchRow:
    numbers = {
        "steps_per_s": control_n / own_s,
        "bare_per_s": control_n / bare_s,
        "ratio": own_s / bare_s,
    }
    return BenchRow(name, numbers, limits)

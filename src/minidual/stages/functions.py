"""Functions of stages and tools, imported when a command needs them.

`minidual status` reads the table of stages in a fraction of a second. Planner, simulator and
learning take seconds to import.
"""

from collections.abc import Callable, Sequence

from minidual.config.root import Config
from minidual.gate.stage import StageFunction, ToolFunction
from minidual.registry import Deferred

type Resolve = Callable[[Config], Config]
type ConfigCheck = Callable[[Config], None]
type Needs = Callable[[Config], Sequence[str]]

# Stages


@Deferred
def env_check() -> StageFunction:
    from minidual.stages.env_check.stage import run

    return run


@Deferred
def plan() -> StageFunction:
    from minidual.stages.plan import run

    return run


@Deferred
def carry() -> StageFunction:
    from minidual.stages.carry import run

    return run


@Deferred
def teleop_record() -> StageFunction:
    from minidual.stages.teleop_record import run

    return run


@Deferred
def train_act() -> StageFunction:
    from minidual.stages.train_act import run

    return run


@Deferred
def deploy() -> StageFunction:
    from minidual.stages.deploy import run

    return run


@Deferred
def benchmark() -> StageFunction:
    from minidual.stages.benchmark import run

    return run


@Deferred
def report() -> StageFunction:
    from minidual.stages.report import run

    return run


# Tools, alone or as asides of stages


@Deferred
def env_check_bill() -> ToolFunction:
    from minidual.stages.env_check.installation import print_bill

    return print_bill


@Deferred
def plan_acm() -> ToolFunction:
    from minidual.stages.plan_acm import plan_acm

    return plan_acm


@Deferred
def plan_once() -> ToolFunction:
    from minidual.stages.plan_once import plan_once

    return plan_once


@Deferred
def plan_task() -> ToolFunction:
    from minidual.stages.plan_task import plan_task

    return plan_task


@Deferred
def demo() -> ToolFunction:
    from minidual.stages.demo import demo

    return demo


@Deferred
def try_out() -> ToolFunction:
    from minidual.stages.try_out import try_out

    return try_out


@Deferred
def train() -> ToolFunction:
    from minidual.stages.train import train

    return train


@Deferred
def train_dataset() -> ToolFunction:
    from minidual.stages.train_dataset import train_dataset

    return train_dataset


@Deferred
def data_augment() -> ToolFunction:
    from minidual.stages.data_augment import data_augment

    return data_augment


@Deferred
def carry_perturb() -> ToolFunction:
    from minidual.stages.carry_tools import perturb

    return perturb


@Deferred
def carry_tune() -> ToolFunction:
    from minidual.stages.carry_tools import tune

    return tune


@Deferred
def doctor() -> ToolFunction:
    from minidual.stages.doctor import doctor

    return doctor


@Deferred
def view() -> ToolFunction:
    from minidual.stages.scene_view import view_scene

    return view_scene


@Deferred
def replay() -> ToolFunction:
    from minidual.stages.replay import replay_tool

    return replay_tool


@Deferred
def lead() -> ToolFunction:
    from minidual.stages.lead import lead

    return lead


@Deferred
def modes() -> ToolFunction:
    from minidual.stages.modes import modes

    return modes


@Deferred
def bridge() -> ToolFunction:
    from minidual.stages.bridge import bridge

    return bridge


# What resolves a configuration before a run


@Deferred
def task_config() -> Resolve:
    from minidual.tasks.catalogue import task_config

    return task_config


@Deferred
def deploy_config() -> Resolve:
    from minidual.stages.policy_folders import deploy_config

    return deploy_config


@Deferred
def benchmark_config() -> Resolve:
    from minidual.stages.policy_folders import benchmark_config

    return benchmark_config


# Which of the stages that a stage may require a configuration needs


@Deferred
def deploy_needs() -> Needs:
    from minidual.stages.policy_folders import deploy_needs

    return deploy_needs


@Deferred
def benchmark_needs() -> Needs:
    from minidual.trials.compared import benchmark_needs

    return benchmark_needs


# What checks a configuration before a run


@Deferred
def check_plant() -> ConfigCheck:
    from minidual.stages.plants import check_plant

    return check_plant


@Deferred
def check_plan() -> ConfigCheck:
    from minidual.stages.config_checks import check_plan

    return check_plan


@Deferred
def check_carry() -> ConfigCheck:
    from minidual.stages.config_checks import check_carry

    return check_carry


@Deferred
def check_leader() -> ConfigCheck:
    from minidual.stages.config_checks import check_leader

    return check_leader


@Deferred
def check_policy() -> ConfigCheck:
    from minidual.stages.config_checks import check_policy

    return check_policy


@Deferred
def check_deploy() -> ConfigCheck:
    from minidual.stages.config_checks import check_deploy

    return check_deploy


@Deferred
def check_benchmark() -> ConfigCheck:
    from minidual.stages.config_checks import check_benchmark

    return check_benchmark

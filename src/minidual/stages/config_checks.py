"""Configuration errors that the models cannot detect, checked before a run."""

from minidual.config.root import Config
from minidual.demos.leader import LEADERS
from minidual.errors import ConfigError, UsageError
from minidual.motion.search import PLANNERS
from minidual.motion.timing_engines import TIMING_ENGINES
from minidual.policies.inputs import signals_remedy
from minidual.policies.kinds import POLICIES, require_library
from minidual.robot.pair import robot_from
from minidual.stages.plants import simulator_only
from minidual.tasks.catalogue import make_task, tasks_of
from minidual.trials.benchmark import trials_asked
from minidual.trials.compared import benchmark_methods
from minidual.trials.conditions import CONDITIONS, condition, parse_conditions, rooms
from minidual.trials.methods import METHODS, check_able

_NO_CORRECTORS = ("scripted", "augmented", "replay")
"""Leaders that know an episode from its start only."""


def check_plan(config: Config) -> None:
    """Check the names of arm, planners and timing engine, and the seeds of the query sets.

    Raises:
        UsageError: Unknown arm, planner or engine, or query sets with equal seeds.
    """
    robot_from(config.robot)
    settings = config.plan.planner
    PLANNERS.names(tuple({settings.planner, *settings.fallback_planners}))
    TIMING_ENGINES.names((settings.timing,))
    if config.plan.second_queries_n and config.seed == config.plan.second_seed:
        raise ConfigError(
            f"seed and plan.second_seed are both {config.seed}: "
            "the second query set would be the first one",
            remedy="choose another --seed, or --set plan.second_seed=NUMBER",
        )


def check_carry(config: Config) -> None:
    """Raise UsageError unless both hands hold one object, in the simulator."""
    simulator_only(config, "carry")
    check_together(config)


def check_together(config: Config) -> None:
    """Raise UsageError unless both hands hold one object."""
    if not make_task(config).together:
        raise ConfigError(
            f"both hands carry one object; in the task '{config.task}' they do not",
            remedy=f"leave the task out; then teleop-record --task {config.task}, train-act, "
            f"deploy --task {config.task}",
        )


def check_leader(config: Config) -> None:
    """Check the leader, the plant, the conditions, and the signals that the policy is to read.

    Raises:
        UsageError: One is unknown, or cannot be recorded.
    """
    simulator_only(config, "teleop-record")
    LEADERS[config.teleop.leader]
    if config.teleop.correct and config.teleop.leader in _NO_CORRECTORS:
        raise UsageError(
            f"the leader '{config.teleop.leader}' plays an episode from its start; it cannot "
            "correct a policy",
            remedy="--set teleop.leader=corrector, browser, gamepad, keyboard, gello or network",
        )
    rooms(config.teleop.conditions)
    _check_signals(config)


def _check_signals(config: Config) -> None:
    unrecorded = [name for name in config.train.inputs if name not in config.teleop.signals]
    if unrecorded:
        recorded = ", ".join(config.teleop.signals) or "none"
        raise ConfigError(
            f"train.inputs asks for {', '.join(unrecorded)}; the signals that episodes hold "
            f"(teleop.signals) are {recorded}",
            remedy=signals_remedy([*config.teleop.signals, *unrecorded]),
        )


def check_policy(config: Config) -> None:
    """Check the policy and the device that trains it.

    Raises:
        UsageError: Unknown policy.
        EnvironmentMissingError: The device is missing, or a library.
    """
    POLICIES.names([config.train.policy])
    require_library(config.train.policy)
    _check_device(config, config.train.device)


def _check_device(config: Config, device: str) -> None:
    if device != "cpu":  # its library takes seconds to load
        POLICIES[config.train.policy].require(device)


def check_deploy(config: Config) -> None:
    """Check the device and the conditions of the policy.

    Raises:
        UsageError: A condition is unknown or cannot affect the policy.
        EnvironmentMissingError: The device is missing.
    """
    simulator_only(config, "deploy")
    _check_device(config, config.deploy.device)
    for name in config.deploy.conditions:
        reason = CONDITIONS[name].why_not("act", config)
        if reason:
            raise ConfigError(
                f"deploy.conditions: '{name}' does not apply: {reason}",
                remedy="leave it out",
            )


def check_benchmark(config: Config) -> None:
    """Raise UsageError for invalid methods, conditions and limits, or another plant."""
    simulator_only(config, "benchmark")
    tasks = tasks_of(config).values()
    for name in benchmark_methods(config):
        check_able(name, tasks)  # the stage looks at what a policy was trained on
    for name in config.benchmark.success_rate_min:
        METHODS[name]  # refuses an unknown name
    trials_asked(config)  # refuses unknown names
    for name in parse_conditions(config.benchmark.conditions):
        for task in tasks:
            condition(name).config_under(task.config)  # refuses values out of bounds

"""Root of the configuration, with small sections, and validated changes."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from minidual.config.base import AtLeast, Rate, StrictModel
from minidual.config.control import ArbiterConfig, CarryConfig, EnvCheckConfig, SupervisorConfig
from minidual.config.learning import DeployConfig, TeleopConfig, TrainConfig
from minidual.config.methods import MethodsConfig
from minidual.config.planning import PlanConfig
from minidual.config.plant import PlantConfig
from minidual.config.scene import RobotConfig, SceneConfig, SemanticsConfig
from minidual.errors import unknown_name


class BenchmarkConfig(StrictModel):
    """Configuration of `benchmark`."""

    tasks: tuple[str, ...] = ()
    """Empty: the run's `task` and `further_tasks`."""
    further_tasks: dict[str, Annotated[int, Field(ge=1, le=10000)]] = Field(default={})
    """Undisturbed trials of each method in other tasks, {task: trials}; at most `trials_n`."""
    methods: AtLeast[tuple[str, ...]] = Field(default=("moveit", "impedance", "act"), min_length=1)
    policies: dict[str, str] = Field(default={})
    """Folder of the policy, or of policies by task, of a learned method; or address of a server.

    Without: that of the run for `act`, those that come with the package for others. A name that is
    no method's makes a method of the policy; `methods` must have it too.
    """
    policy_digests: dict[str, str] = Field(default={})
    """Filled in: what the policies from outside the run are, {method/task: digest}."""
    conditions: AtLeast[tuple[str, ...]] = Field(default=("clean",), min_length=1)
    """Conditions, with `clean`; or `all`."""
    trials_n: AtLeast[int] = Field(default=30, ge=1, le=10000)
    """Undisturbed trials of each method, which have limits."""
    perturbed_trials_n: AtLeast[int] = Field(default=20, ge=1, le=10000)
    """Trials of each method under each other condition, on the first of the same starts."""
    condition_trials: AtLeast[dict[str, dict[str, Annotated[int, Field(ge=1, le=10000)]]]] = Field(
        default={},
    )
    """Trials of each method under conditions that tell methods apart, {condition: {task: trials}}.

    They hold where they are more than `perturbed_trials_n`. Further tasks have them beside their
    undisturbed trials. A condition that `conditions` does not name has none.
    """
    first_start: int = Field(default=0, ge=0, le=10_000_000)
    """Number of the first start."""
    films: bool = False
    """Whether to film a start of each task, all methods side by side."""
    success_rate_min: AtLeast[dict[str, Rate]] = Field(
        default={"moveit": 0.8, "impedance": 0.8, "act": 0.5},
    )
    """By method; others are only reported."""


class ReportConfig(StrictModel):
    """Configuration of `report`."""

    title: str = Field(default="minidual: a measured dual-arm system", min_length=1)
    language: Literal["en", "zh"] = "en"
    """Of the page; report.json is in English."""


Origin = Annotated[str, Field(pattern=r"^https?://[a-z0-9.-]+(:[0-9]{1,5})?$", max_length=200)]
"""Scheme, host and port of a page, as a browser sends them."""


class ViewConfig(StrictModel):
    """The live web view; no stage depends on it."""

    host: str = Field(default="127.0.0.1", min_length=1)
    """Network interface; the default serves this machine only."""
    port: int = Field(default=8080, ge=1, le=65535)
    remote_drives: bool = False
    """Whether pages on other machines may move sliders.

    Those that come through ssh count as on this machine.
    """
    origins: tuple[Origin, ...] = Field(default=(), max_length=16)
    """Addresses under which a proxy shows the view, such as "https://lab.example.org".

    Pages that come through it count as on other machines.
    """
    rate_hz: float = Field(default=30.0, ge=1.0, le=120.0)
    speed_max: float = Field(default=0.0, ge=0.0, le=100.0)
    """Most simulated seconds per wall second; 0: no limit."""
    shadows: bool = True
    """Whether pages draw shadows; without a graphics card they take most of the time."""


class Config(StrictModel):
    """Resolved configuration of a run."""

    acceptance: bool = True
    """Whether verdicts count as acceptance; extending profiles cannot revert `false`."""
    seed: int = Field(default=20260, ge=0, lt=2**63)
    """Seed of all named random streams."""
    workers: int = Field(default=2, ge=1, le=512)
    """Processes of a stage; results do not depend on it."""

    robot: RobotConfig = RobotConfig()
    task: str = "rod_carry"

    env_check: EnvCheckConfig = EnvCheckConfig()
    plan: PlanConfig = PlanConfig()
    carry: CarryConfig = CarryConfig()
    teleop: TeleopConfig = TeleopConfig()
    train: TrainConfig = TrainConfig()
    deploy: DeployConfig = DeployConfig()
    methods: MethodsConfig = MethodsConfig()
    benchmark: BenchmarkConfig = BenchmarkConfig()
    report: ReportConfig = ReportConfig()
    scene: SceneConfig = SceneConfig()
    semantics: SemanticsConfig = SemanticsConfig()
    arbiter: ArbiterConfig = ArbiterConfig()
    supervisor: SupervisorConfig = SupervisorConfig()
    plant: PlantConfig = PlantConfig()
    view: ViewConfig = ViewConfig()

    def demands(self) -> dict[str, Any]:
        """Return what the benchmark's tasks ask for together.

        `benchmark.tasks` replaces `further_tasks`: neither says alone what is asked for.

        Returns:
            The undisturbed trials of each named or further task, whether the benchmark has the
            run's own task, and whether no policy from elsewhere was named, there and in `deploy`.
        """
        benchmark = self.benchmark
        if benchmark.tasks:
            trials = dict.fromkeys(benchmark.tasks, benchmark.trials_n)
        else:
            trials = benchmark.further_tasks
        return {
            "benchmark.tasks": trials,
            "benchmark.own_task": not benchmark.tasks or self.task in benchmark.tasks,
            "benchmark.own_policies": not benchmark.policies,
            "deploy.own_policy": not self.deploy.policy,
        }


def changed[M: BaseModel](section: M, values: Mapping[str, Any], *, unset_only: bool = False) -> M:
    """Return a section with {dotted path: value} applied.

    Args:
        section: Part of a configuration.
        values: New values.
        unset_only: Apply them only where the user set nothing.

    Raises:
        UsageError: There is no such path.
        pydantic.ValidationError: The values are invalid together.
    """
    own: dict[str, Any] = {}
    inner: dict[str, dict[str, Any]] = {}
    for path, value in values.items():
        name, _, rest = path.partition(".")
        if name not in type(section).model_fields:
            raise unknown_name("configuration value", path, type(section).model_fields)
        if rest:
            inner.setdefault(name, {})[rest] = value
        elif not unset_only or name not in section.model_fields_set:
            own[name] = value
        elif isinstance(getattr(section, name), BaseModel) and isinstance(value, BaseModel):
            fields = {field: getattr(value, field) for field in value.model_fields_set}
            inner.setdefault(name, {}).update(fields)
    for name, part in inner.items():
        own[name] = changed(getattr(section, name), part, unset_only=unset_only)
    return replaced(section, **own)


def preset[M: BaseModel](section: M, values: Mapping[str, Any]) -> M:
    """Return a section with {dotted path: value} applied where the user set nothing.

    Raises:
        UsageError, pydantic.ValidationError: See `changed`.
    """
    return changed(section, values, unset_only=True)


def replaced[M: BaseModel](section: M, **values: Any) -> M:
    """Return a validated copy with `values`; other unset fields stay unset."""
    set_values = {name: getattr(section, name) for name in section.model_fields_set}
    return type(section).model_validate({**set_values, **values})

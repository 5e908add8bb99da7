"""Root of the configuration."""

from pydantic import Field

from minidual.config.arbiter import ArbiterConfig
from minidual.config.base import StrictModel
from minidual.config.control import CarryConfig, EnvCheckConfig
from minidual.config.evaluation import BenchmarkConfig, ReportConfig
from minidual.config.learning import DeployConfig, TrainConfig
from minidual.config.planning import PlanConfig
from minidual.config.robot import RobotConfig, SemanticsConfig
from minidual.config.scene import SceneConfig
from minidual.config.supervisor import SupervisorConfig
from minidual.config.teleop import TeleopConfig
from minidual.config.view import ViewConfig


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
    benchmark: BenchmarkConfig = BenchmarkConfig()
    report: ReportConfig = ReportConfig()
    scene: SceneConfig = SceneConfig()
    semantics: SemanticsConfig = SemanticsConfig()
    arbiter: ArbiterConfig = ArbiterConfig()
    supervisor: SupervisorConfig = SupervisorConfig()
    view: ViewConfig = ViewConfig()

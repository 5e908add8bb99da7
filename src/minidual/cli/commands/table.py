"""Tables of the commands.

A stage or tool without a function here, such as one of another distribution, gets its command from
its row (`minidual.cli.rows`).
"""

from minidual.cli.commands.benchmark import benchmark
from minidual.cli.commands.bridge import bridge
from minidual.cli.commands.carry import carry
from minidual.cli.commands.config_forget import config_forget
from minidual.cli.commands.config_show import config_show
from minidual.cli.commands.data import (
    data_augment,
    data_check,
    data_merge,
    data_show,
    data_split,
    data_stats,
)
from minidual.cli.commands.data_export import data_export
from minidual.cli.commands.data_import import data_import
from minidual.cli.commands.demo import demo
from minidual.cli.commands.deploy import deploy
from minidual.cli.commands.doctor import doctor
from minidual.cli.commands.env_check import env_check
from minidual.cli.commands.explain import explain
from minidual.cli.commands.export_ros2 import export_ros2
from minidual.cli.commands.lead import lead
from minidual.cli.commands.leader_calibrate import leader_calibrate
from minidual.cli.commands.migrate import migrate
from minidual.cli.commands.modes import modes
from minidual.cli.commands.plan import plan
from minidual.cli.commands.plant_serve import plant_serve
from minidual.cli.commands.replay import replay
from minidual.cli.commands.report import report
from minidual.cli.commands.run import run
from minidual.cli.commands.status import status
from minidual.cli.commands.stop import stop
from minidual.cli.commands.teleop_record import teleop_record
from minidual.cli.commands.train import train
from minidual.cli.commands.train_act import train_act
from minidual.cli.commands.try_out import try_out
from minidual.cli.commands.view import view
from minidual.cli.signature import Command

STAGE_COMMANDS: dict[str, Command] = {
    "env-check": env_check,
    "plan": plan,
    "carry": carry,
    "teleop-record": teleop_record,
    "train-act": train_act,
    "deploy": deploy,
    "benchmark": benchmark,
    "report": report,
}
RUN_COMMANDS: dict[str, Command] = {
    "run": run,
    "status": status,
    "explain": explain,
    "stop": stop,
    "migrate": migrate,
}
CONFIG_COMMANDS: dict[str, Command] = {"show": config_show, "forget": config_forget}
TOOL_GROUPS: dict[str, tuple[str, dict[str, Command]]] = {
    "leader": ("Devices that lead the arms.", {"calibrate": leader_calibrate}),
    "plant": ("What the arms are: the emulator of two controllers.", {"serve": plant_serve}),
    "export": ("Files for other programs.", {"ros2": export_ros2}),
    "data": (
        "Demonstrations of any origin.",
        {
            "augment": data_augment,
            "check": data_check,
            "stats": data_stats,
            "show": data_show,
            "merge": data_merge,
            "split": data_split,
            "export": data_export,
            "import": data_import,
        },
    ),
}
"""Help and commands of tools of two words, by first word."""
TOOL_COMMANDS: dict[str, Command] = {
    "demo": demo,
    "try": try_out,
    "train": train,
    "doctor": doctor,
    "view": view,
    "replay": replay,
    "modes": modes,
    "lead": lead,
    "bridge": bridge,
}
READING = ("status", "explain", "doctor", "report")
"""Commands that only read a run: a run that was named must exist. The others begin one."""

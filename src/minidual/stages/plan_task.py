"""`minidual plan --task NAME`: plan, simulate and judge one whole task."""

from pathlib import Path
from typing import cast

from minidual.config.root import replaced
from minidual.durable import disk_errors
from minidual.errors import ExitCode
from minidual.gate.stage import ToolContext, ToolResult
from minidual.plant.simulation import Simulation
from minidual.plant.world import World
from minidual.robot.pair import robot_from
from minidual.show.figures.film import FILM_FPS, Postures, film_postures
from minidual.show.figures.film_model import painted
from minidual.show.watch import trial_hook
from minidual.skills.planned_carry import PlannedCarry
from minidual.stages.output_file import target_file
from minidual.tasks.catalogue import TASKS
from minidual.tasks.task import Trial, placement
from minidual.trials.methods import Method, MethodInputs
from minidual.trials.runner import Bench


def plan_task(context: ToolContext) -> ToolResult:
    """Solve the --task; exit 1 if unsolved or failed, 2 if unknown."""
    name = context.options["task"]
    video = target_file("video", context.options.get("video"), ".mp4")
    config = TASKS[name](replaced(context.config, task=name)).config
    bench = Bench("moveit", MethodInputs(config, context.seed))
    trial = bench.task.trial(context.seed, "plan", 0)
    postures = Postures(1.0 / FILM_FPS)
    show = None if context.view is None else trial_hook(context.view, bench, f"plan, task {name}")

    def on_step(world: Simulation, method: Method) -> None:
        postures(world)
        if show is not None:
            show(world, method)

    result, _ = bench.run(trial, on_step=on_step)
    carry = cast(PlannedCarry, bench.ran)
    solution = carry.solution
    lines = carry.record.tree(name).splitlines()
    notes: list[str] = []
    if solution is not None:
        lines.append(
            f"planned {solution.duration_s:.2f} s of motion; "
            f"driven in the simulator: {result.text}",
        )
        if video is not None:
            _film(bench, trial, postures, video)
            notes.append(f"film: {video}")
    data = {
        "task": name,
        "seed": context.seed,
        "solved": solution is not None,
        "success": result.success,
        "result": result.text,
        "duration_s": None if solution is None else solution.duration_s,
        "record": carry.record.to_json(),
    }
    code = ExitCode.PASS if result.success else ExitCode.ACCEPTANCE_FAILED
    return ToolResult(lines, notes, data, code)


def _film(bench: Bench, trial: Trial, postures: Postures, path: Path) -> None:
    """Write a film of the postures in a world with the goal."""
    config = bench.task.config
    world = World(config.scene, robot_from(config.robot))
    world.mark_goal(*placement(trial.goal[bench.task.carried]))
    with disk_errors(path):
        film_postures(painted(world.scene, world.robot, world.model), postures.qpos, path)

"""Phases of a carry under object impedance, in order.

Source `moveit` proposes joint motions for free hands (controller A) and object motions for holding
hands (C). See docs/carry.md.
"""

from collections.abc import Generator, Iterator

import numpy as np

from minidual.config.control import CarryConfig
from minidual.config.scene import SceneConfig
from minidual.control.commands import Command, JointCommand, ObjectCommand, TrajectoryCommand
from minidual.control.stack import DEFAULT_CONTROLLERS, OBJECT_CONTROLLERS, ControlStack
from minidual.control.supervisor import Supervisor
from minidual.plant.protocol import Plant
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, inverse
from minidual.skills.carry_motions import (
    grasp_posture,
    held_motion,
    held_object,
    joint_move,
    plan_path,
    posture_over,
)
from minidual.skills.carry_watch import CarryWatch
from minidual.skills.object_path import ObjectPath
from minidual.skills.phases import PHASES
from minidual.skills.pipeline.drive import SOURCE
from minidual.skills.things import thing_of
from minidual.tasks.task import Placement, level_part, placement, pose_of

_OPEN = np.ones(2)
_CLOSED = np.zeros(2)
_APPROACHES = 3
"""Times that the hands go over the object; a shift during the last one is a fault."""
_ARRIVALS = 4
"""Most corrections of a path's end."""
_ONWARD_S = 0.8
"""Time of a correction."""
_ARRIVED_M = 0.003
"""Distance from the goal that needs no correction."""
_STRETCH_M = 0.036
"""Longest stretch of the law's spring."""
_CALM_S = 2.0
"""Longest wait for arms at rest before the hands open."""


class RefusedError(Exception):
    """A proposed command was refused."""


class CarryPhases:
    """Proposes the commands of a carry, phase by phase.

    The first four arguments say what is to be done, the others by what.

    Args:
        kinematics: Of the arms.
        scene: With the object.
        config: Pace and impedance.
        goal: Of the object.
        stack: Takes the commands.
        watch: Senses the object.
        supervisor: Is told what the hands hold.
        open_s: Duration of the phase `open`.

    Attributes:
        phase: Present phase.
        began_s: Time at which it began.
        follows: Whether a shift of the object in this approach is followed.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        scene: SceneConfig,
        config: CarryConfig,
        goal: Placement,
        *,
        stack: ControlStack[Plant],
        watch: CarryWatch,
        supervisor: Supervisor,
        open_s: float,
    ) -> None:
        self._plant = stack.plant
        self._scene = scene
        self._kinematics = kinematics
        self._config = config
        self._goal = goal
        self._stack = stack
        self._watch = watch
        self._supervisor = supervisor
        self._open_s = open_s
        self._sequence = 0
        self.phase = "approach"
        self.began_s = self._plant.time
        self.follows = True

    def enter(self, phase: str) -> None:
        """Begin a phase."""
        self.phase = phase
        self.began_s = self._plant.time

    def run(self) -> Iterator[None]:
        """Go through all phases; each `next` is one control step.

        Raises:
            PoseUnreachableError: A hand cannot reach its grasp, or follow the path.
            SingularPostureError: The law cannot take over at the grasp.
            RefusedError: The arbiter refused a command.
        """
        plant = self._plant
        watch = self._watch
        stack = self._stack
        rise_m = PHASES["approach"].rise_m
        q_over = posture_over(self._scene, plant.robot, self._lying(), rise_m)
        self._grasp(q_over)  # raises before anything moves
        stack.request(SOURCE)
        q_start = plant.q
        while stack.source != SOURCE:
            yield
        q_over = yield from self._approach(q_start, q_over)
        q_grasp = self._grasp(q_over)  # by the mean of all poses so far, about a hundred
        rest_m = float(watch.T_world_object[2, 3])
        yield from self._move("descend", q_over, q_grasp)
        yield from self._close(q_grasp)
        yield from self._transport(rest_m)
        q = plant.q
        yield from self._move("open", q, q, self._open_s)
        q_away = self._grasp(q, above_m=PHASES["retreat"].rise_m)
        yield from self._move("retreat", q, q_away)

    # Free hands --------------------------------------------------------------------------------

    def _approach(self, q: Array, q_over: Array) -> Generator[None, None, Array]:
        """Go over the object, again where it was shifted; return the posture (n,) there."""
        watch = self._watch
        for attempt in range(1, _APPROACHES + 1):
            self.follows = attempt < _APPROACHES
            yield from self._move("approach", q, q_over)
            if not watch.shifted:
                break
            watch.shifted = False
            q = q_over
            q_over = self._grasp(q, above_m=PHASES["approach"].rise_m)
        return q_over

    def _close(self, q: Array) -> Iterator[None]:
        """Close the hands at q (n,) until both pinch.

        The posture is streamed, because the end depends on the pinch and not on time.
        """
        self._propose("close", self._posture(q))
        while not self._watch.gripped:
            yield
            if self._stack.tick_next:
                self._propose("close", self._posture(q))

    def _posture(self, q: Array) -> JointCommand:
        return JointCommand(q, _CLOSED, self._plant.time, self._next())

    def _grasp(self, q_near: Array, *, above_m: float = 0.0) -> Array:
        """Return the posture (n,) at or above the grasps."""
        plant = self._plant
        return grasp_posture(self._scene, plant.robot, self._lying(), q_near, above_m=above_m)

    def _lying(self) -> Array:
        """Return the object's pose (4, 4) at its known height on the table."""
        return pose_of(self._scene.object, placement(self._watch.T_world_object))

    def _move(
        self,
        phase: str,
        q: Array,
        q_goal: Array,
        duration_s: float | None = None,
    ) -> Iterator[None]:
        """Move open hands from q to q_goal (n,)."""
        plant = self._plant
        motion = joint_move(q, q_goal, plant.robot, self._config.pace, plant.dt, duration_s)
        command = TrajectoryCommand(motion, _OPEN, plant.time, self._next())
        self._propose(phase, command)
        yield from self._executing()

    # Held object -------------------------------------------------------------------------------

    def _transport(self, rest_m: float) -> Iterator[None]:
        """Take hold of the object, carry it to the goal, and unload it there."""
        plant = self._plant
        watch = self._watch
        stack = self._stack
        T_object = watch.T_world_object
        path = plan_path(
            self._scene,
            plant.robot,
            self._config.pace,
            self._goal,
            T_object,
            plant.q,
            rest_m,
        )
        T_level_object = inverse(level_part(T_object)) @ T_object
        self._take_hold(T_object)
        yield from self._follow("squeeze", path, T_level_object)
        watch.lift()
        yield from self._follow("carry", path, T_level_object)
        path = yield from self._arrive(path, T_level_object)
        yield from self._follow("unload", path, T_level_object)
        while not stack.calm and plant.time < self.began_s + _CALM_S:
            yield  # the object is down, an elbow may still swing
        watch.sensing.let_go()
        self._supervisor.hold(None)
        stack.switch_controllers(DEFAULT_CONTROLLERS)

    def _take_hold(self, T_object: Array) -> None:
        """Hand the object at T_object (4, 4) over to controller C."""
        scene = self._scene
        tcps = self._kinematics.tcp_poses(self._plant.q)
        model = held_object(scene, T_object, tcps)
        self._stack.impedance.configure(model, self._config.impedance)
        self._watch.sensing.take_hold()
        T_object_shape = thing_of(scene.object).shape.T_parent_shape
        self._supervisor.hold(0, inverse(tcps[0]) @ self._lying() @ T_object_shape)
        self._stack.switch_controllers(OBJECT_CONTROLLERS)

    def _follow(self, phase: str, path: ObjectPath, T_level_object: Array) -> Iterator[None]:
        """Move the object as a phase does on a path; see `held_motion`."""
        squeeze_n = self._watch.squeeze_n
        motion, squeeze_at = held_motion(phase, path, T_level_object, squeeze_n)
        command = ObjectCommand(motion, squeeze_at, _CLOSED, self._plant.time, self._next())
        self._propose(phase, command)
        yield from self._executing()

    def _arrive(self, path: ObjectPath, T_level_object: Array) -> Generator[None, None, ObjectPath]:
        """Move a path's end on until the object is there; return the path.

        Friction in the joints keeps the law's spring stretched.
        """
        goal_m = path.at(path.duration_s, T_level_object).T_world_object[:3, 3]
        end_m = goal_m
        for _ in range(_ARRIVALS):
            position_m = self._watch.T_world_object[:3, 3]
            short_m = float(np.linalg.norm(goal_m - position_m))
            stretched_m = float(np.linalg.norm(end_m - position_m))
            if short_m < _ARRIVED_M or stretched_m >= _STRETCH_M:
                break
            share = min(1.0, (_STRETCH_M - stretched_m) / short_m)
            onward_m = (goal_m - position_m) * share
            path = path.onward(onward_m, _ONWARD_S)
            end_m = end_m + onward_m
            yield from self._follow("carry", path, T_level_object)
        return path

    # Commands ----------------------------------------------------------------------------------

    def _next(self) -> int:
        """Return the sequence number of a new command."""
        self._sequence += 1
        return self._sequence

    def _propose(self, phase: str, command: Command) -> None:
        refusal = self._stack.propose(SOURCE, command)
        if refusal is not None:
            raise RefusedError(f"{refusal.name}: {refusal.detail}")
        if phase != self.phase:
            self.enter(phase)

    def _executing(self) -> Iterator[None]:
        yield
        while self._stack.executing:
            if self._goes_down():
                self._supervisor.lower()  # the object may land early
            yield

    def _goes_down(self) -> bool:
        """Return whether the carried object is on its way down."""
        desired = self._stack.impedance.desired
        return self.phase == "carry" and desired is not None and desired.twist[2] < 0.0

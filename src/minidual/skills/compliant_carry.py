"""Execute a planned task by impedance where objects may touch."""

from collections.abc import Mapping

import pinocchio as pin

from minidual.control.hand_impedance import InHand
from minidual.control.stack import DEFAULT_CONTROLLERS, ControlStack
from minidual.errors import DataError
from minidual.motion.api import Planner
from minidual.plant.protocol import ObjectSensors, Plant
from minidual.robot.pair import SIDES, Array, inverse, pose
from minidual.skills.askew import EVERY_S, AskewSearch, HeldPart, Mating, Meeting, part_in_hand
from minidual.skills.planned_carry import PlannedCarry
from minidual.skills.states import OPEN, Segment
from minidual.tasks.task import Task, Trial

_LOOK_PHASE = "carry"
"""Phase at whose end the camera measures the held parts."""
_LOOKS_N = 20


class CompliantCarry(PlannedCarry):
    """One planned trial; the `soft` hands of a segment run under impedance.

    Attributes:
        sensors: Of the objects' poses, by name; they tell how parts turn in the hands. Empty: the
            signs of parts that stand askew are guessed.
    """

    by_force = True

    def __init__(
        self,
        stack: ControlStack[Plant],
        planner: Planner,
        task: Task,
        trial: Trial,
        seed: int,
        poses: Mapping[str, Array],
    ) -> None:
        self.sensors: Mapping[str, ObjectSensors] = {}
        self._turns: dict[str, list[float]] = {}
        self._mating: Mating | None = None
        self._mating_tick = 0
        super().__init__(stack, planner, task, trial, seed, poses)

    @property
    def done(self) -> bool:
        """See `Drive`; a mating that is busy is waited for."""
        mating = self._mating
        waits = mating is not None and self.aborted is None and mating.busy(self.plant.time)
        return super().done and not waits

    def step(self) -> None:
        """See `PlannedCarry`."""
        if self.phase == _LOOK_PHASE and not self.task.together:
            self._look()
        if self._mating is not None:
            self._mate(self._mating)
        super().step()

    def _take_control(self, segment: Segment) -> None:
        stack = self.stack
        self._note_grasps(segment)
        names = DEFAULT_CONTROLLERS
        if segment.soft:
            names = tuple(f"{side}_{'hand' if side in segment.soft else 'arm'}" for side in SIDES)
        if names == stack.manager.active:
            return
        left, right = (hand.law for hand in stack.hands)
        inserts = segment.phase == "insert"
        left.other = right.held if inserts else None
        right.other = left.held if inserts else None
        self._mating = self._new_mating(self._meeting(segment)) if inserts else None
        self._mating_tick = 0
        stack.switch_controllers(names)

    # Parts that stand askew --------------------------------------------------------------------

    def _look(self) -> None:
        """Note how the camera sees parts turned about the axes of the hands that hold them."""
        tips: list[Array] | None = None
        for arm, hand in enumerate(self.stack.hands):
            held = hand.law.held
            if held.name not in self.sensors:
                continue
            sample = self.sensors[held.name].sense().pose
            if sample is None:
                continue
            if tips is None:
                tips = list(self.stack.kinematics.tcp_poses(self.plant.q))
            R = tips[arm][:3, :3].T @ sample.T_world_object[:3, :3]
            turn = pin.log3(R @ held.T_tcp_planned[:3, :3].T)
            turns = self._turns.setdefault(held.name, [])
            turns.append(float(turn[2]))
            del turns[:-_LOOKS_N]

    def _new_mating(self, meeting: Meeting) -> Mating | None:
        """Return the mating that acts while the soft hand pushes; None pushes straight on."""
        return AskewSearch(meeting)

    def _meeting(self, segment: Segment) -> Meeting:
        """Return the parts that the soft hand of a segment is about to put together."""
        (side,) = segment.soft
        own = SIDES.index(side)
        parts = [self._part(arm) for arm in range(len(SIDES))]
        law = self.stack.hands[own].law
        return Meeting(law, parts[own], parts[1 - own], own, self.plant.time)

    def _part(self, arm: int) -> HeldPart:
        """Return the part in a hand, askew by the gap of its fingers."""
        held = self.stack.hands[arm].law.held
        if not held.name:
            return HeldPart(held, 0.0)
        width_m = 2.0 * self.task.objects[held.name].body.half_width_m
        gap_m = 2.0 * float(self.plant.fingers[arm])
        return part_in_hand(held, gap_m, width_m, self._turns.get(held.name, []))

    def _mate(self, mating: Mating) -> None:
        """Run the mating while the part is pushed in; an invalid reading stops the arms."""
        if self.stack.stopping or self.aborted is not None:
            self._mating = None
            return
        every = round(EVERY_S / self.plant.dt)
        self._mating_tick += 1
        soft = any(hand.name in self.stack.manager.active for hand in self.stack.hands)
        if self._mating_tick % every or not soft:
            return
        try:
            mating.update(self.plant.q, self.stack.manager.reference, self.plant.time)
        except DataError as error:  # the arms need this step's torque
            self.stack.fail(error)

    # Grasps ------------------------------------------------------------------------------------

    def _note_grasps(self, segment: Segment) -> None:
        """Note where in closed hands objects are, from where they lay."""
        tips = self.stack.kinematics.tcp_poses(self.plant.q)
        laws = [hand.law for hand in self.stack.hands]
        for T_world_tcp, law, opening in zip(tips, laws, segment.openings, strict=True):
            if law.held.name:
                self._poses[law.held.name] = T_world_tcp @ law.held.T_tcp_object
            if opening == OPEN:
                law.held = InHand()
        if segment.scene is None:
            return
        for attached in segment.scene.attached:
            arm = self.plant.robot.tcp_names.index(attached.link)
            law = laws[arm]
            if law.held.name != attached.name:
                planned = attached.shape.T_parent_shape
                sensed = inverse(tips[arm]) @ self._poses[attached.name]
                touches_m = self.task.objects[attached.name].touches_m
                law.held = InHand(attached.name, _centred(sensed, planned), planned, touches_m)


def _centred(T_tcp_object: Array, planned: Array) -> Array:
    """Return the pose after fingers, closing along y, have centred and turned the object.

    Args:
        T_tcp_object: (4, 4), sensed.
        planned: (4, 4), in the plan.
    """
    turn = pin.log3(T_tcp_object[:3, :3] @ planned[:3, :3].T) * [0.0, 1.0, 0.0]
    x, _, z = T_tcp_object[:3, 3]
    return pose(pin.exp3(turn) @ planned[:3, :3], (x, planned[1, 3], z))

"""Plan the whole task; execute it by position, by impedance of a hand where what it holds may touch something."""

import pinocchio as pin

from minidual.control.hand_impedance import InHand
from minidual.control.stack import DEFAULT_CONTROLLERS
from minidual.robot.pair import SIDES, Array
from minidual.robot.poses import inverse, pose, rotation_log
from minidual.skills.pipeline.state import OPEN, Segment
from minidual.skills.planned_carry import PlannedCarry


class CompliantCarry(PlannedCarry):
    """One trial; the `soft` hands of a segment run under impedance."""

    by_force = True

    def _take_control(self, segment: Segment) -> None:
        stack, laws = self.stack, [hand.law for hand in self.stack.hands]
        self._note_grasps(segment)
        names = tuple(f"{side}_{'hand' if side in segment.soft else 'arm'}" for side in SIDES)
        names = names if segment.soft else DEFAULT_CONTROLLERS
        if names != stack.manager.active:
            for law, other in zip(laws, reversed(laws), strict=True):
                law.other = other.held if segment.phase == "insert" else None
            stack.switch_controllers(names)

    def _note_grasps(self, segment: Segment) -> None:
        """Note where in closed hands objects are, from where they lay."""
        tips = self.stack.kinematics.tcp_poses(self.world.q)
        laws, poses = [hand.law for hand in self.stack.hands], self._poses
        for T_tcp, law, opening in zip(tips, laws, segment.openings, strict=True):
            if law.held.name:
                poses[law.held.name] = T_tcp @ law.held.T_tcp_object
            if opening == OPEN:
                law.held = InHand()
        for held in () if segment.scene is None else segment.scene.attached:
            arm, item = self.world.robot.tcp_names.index(held.link), self.task.objects[held.name]
            if laws[arm].held.name != held.name:
                planned = held.shape.T_parent_shape
                T = _centred(inverse(tips[arm]) @ poses[held.name], planned)
                laws[arm].held = InHand(held.name, T, planned, item.body.mass_kg, item.touches_m)


def _centred(T_tcp_object: Array, planned: Array) -> Array:
    """Return the pose after fingers, closing along y, have centred the object and turned it along them."""
    turned = rotation_log(T_tcp_object[:3, :3] @ planned[:3, :3].T) * [0.0, 1.0, 0.0]
    x, _, z = T_tcp_object[:3, 3]
    return pose(pin.exp3(turned) @ planned[:3, :3], (x, planned[1, 3], z))

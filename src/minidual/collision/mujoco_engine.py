"""The planning engine: MuJoCo kinematics and collision on convex hulls, without any dynamics.

Only `mj_kinematics` and `mj_collision` run, about 15 us a state for both arms and ten obstacles. The model is
compiled from the same URDF as the simulated world; bodies whose pair is not checked are excluded at compile time.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np

from minidual.collision.links import LINKS
from minidual.collision.scene import Attached, PlanningScene
from minidual.collision.shapes import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from minidual.robot.constants import ARMS, FINGER_JOINT_NAMES, FINGER_TRAVEL_M, JOINT_NAMES, Array
from minidual.robot.description import dual_panda_urdf

# Without these the URDF reader would fuse the fixed links (and the tcp) into their parents.
_COMPILER = '<mujoco><compiler fusestatic="false" discardvisual="true" strippath="false"/></mujoco><link name="world"'
_CLOSEST_WITHIN_M = 0.1


@dataclass(frozen=True)
class PairDistance:
    """Two parts of the scene and the distance between them [m], negative inside each other."""

    first: str
    second: str
    distance_m: float

    def __str__(self) -> str:
        kind = "penetrate by" if self.distance_m < 0 else "are apart by"
        return f"{self.first} and {self.second} {kind} {abs(self.distance_m) * 1e3:.1f} mm"


class MujocoEngine:
    """Collision checks of one scene. One instance holds one workspace: give each process its own."""

    name = "mujoco"

    def __init__(self, scene: PlanningScene) -> None:
        self._build(scene.checked_pairs, scene.solid_obstacles, scene.attached)
        self.min_distance_m = scene.min_distance_m
        carried = {held.name: held.link for held in scene.attached}
        owners = [carried.get(name, name) for name in self._body_names]
        self._of_arm = {arm: np.array([name.startswith(f"{arm}_") for name in owners]) for arm in ARMS}

    @classmethod
    def from_pairs(
        cls, pairs: Iterable[tuple[str, str]], obstacles: Sequence[Shape], attached: Sequence[Attached]
    ) -> MujocoEngine:
        """Return an engine that checks exactly `pairs`; for building the allowed-collision matrix."""
        engine = cls.__new__(cls)
        engine._build(pairs, obstacles, attached)
        return engine

    def _build(
        self, pairs: Iterable[tuple[str, str]], obstacles: Sequence[Shape], attached: Sequence[Attached]
    ) -> None:
        spec = mujoco.MjSpec.from_string(dual_panda_urdf().replace('<link name="world"', _COMPILER, 1))
        for shape in obstacles:
            _add_body(spec, spec.worldbody, shape)
        for held in attached:
            _add_body(spec, spec.body(held.link), held.shape)
        _boxes_to_meshes(spec)
        checked = {frozenset(p) for p in pairs}
        names = (*LINKS, *(s.name for s in obstacles), *(a.name for a in attached))
        for a, b in itertools.combinations(names, 2):
            if frozenset((a, b)) not in checked:
                spec.add_exclude(bodyname1=a, bodyname2=b)
        self.model = spec.compile()
        # The scene alone decides about pairs; MuJoCo's own parent-child filter would hide some.
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
        self.data = mujoco.MjData(self.model)
        for joint in FINGER_JOINT_NAMES:
            self.data.qpos[self.model.joint(joint).qposadr[0]] = FINGER_TRAVEL_M
        addresses = [int(self.model.joint(name).qposadr[0]) for name in JOINT_NAMES]
        # Two contiguous views are written faster than one fancy index.
        self._left = self.data.qpos[addresses[0] : addresses[0] + 7]
        self._right = self.data.qpos[addresses[7] : addresses[7] + 7]
        if addresses != [*range(addresses[0], addresses[0] + 7), *range(addresses[7], addresses[7] + 7)]:
            raise RuntimeError(f"the joints of an arm are not contiguous in qpos: {addresses}")
        self._body_names = [self.model.body(i).name for i in range(self.model.nbody)]
        self.margin_m = 0.0

    def set_margin(self, margin_m: float) -> None:
        """Report pairs nearer than `margin_m`, not only those that touch."""
        if margin_m != self.margin_m:
            self.model.geom_margin[:] = 0.5 * margin_m  # MuJoCo adds the margins of the two geoms
            self.model.body_margin[:] = 0.5 * margin_m
            self.margin_m = margin_m

    def contact_count(self, q: Array) -> int:
        """Place the arms at q (14,) and return how many contacts lie within the margin."""
        self._place(q)
        mujoco.mj_collision(self.model, self.data)
        return self.data.ncon

    def nearest_m(self) -> float:
        """Return the smallest distance among the contacts of the last state [m]; infinity without any."""
        return float(self.data.contact.dist.min()) if self.data.ncon else np.inf

    @contextmanager
    def moving(self, arms: Sequence[str]) -> Iterator[None]:
        """Within the block, check only the pairs of which one part belongs to one of these arms.

        The other pairs do not move while the other arm is held; who uses this must have checked them once.
        """
        if len(arms) == len(ARMS):
            yield
            return
        model = self.model
        before = model.geom_contype.copy(), model.body_contype.copy()
        mine = np.zeros(model.nbody, dtype=bool)
        for arm in arms:
            mine |= self._of_arm[arm]
        try:
            # Two geoms may touch if one's type meets the other's affinity; all affinities stay 1.
            model.body_contype[:] = mine
            model.geom_contype[:] = mine[model.geom_bodyid]
            yield
        finally:
            model.geom_contype[:], model.body_contype[:] = before

    def _place(self, q: Array) -> None:
        self._left[:] = q[:7]
        self._right[:] = q[7:]
        mujoco.mj_kinematics(self.model, self.data)

    def in_collision(self, q: Array) -> bool:
        """Return whether anything touches at q (14,)."""
        self.set_margin(0.0)
        return self.contact_count(q) > 0

    def collisions(self, Q: Array) -> np.ndarray:
        """Return for each row of Q (n, 14) whether anything touches, (n,) bool."""
        self.set_margin(0.0)
        return np.fromiter((self.contact_count(q) > 0 for q in Q), dtype=bool, count=len(Q))

    def contacts(self) -> list[PairDistance]:
        """Return the pairs within the margin at the last state, nearest first, each pair once."""
        count = self.data.ncon
        if count == 0:
            return []
        bodies = self.model.geom_bodyid[self.data.contact.geom[:count]]
        nearest: dict[tuple[str, str], float] = {}
        for (a, b), distance in zip(bodies, self.data.contact.dist[:count], strict=True):
            first, second = sorted((self._body_names[a], self._body_names[b]))
            nearest[first, second] = min(float(distance), nearest.get((first, second), np.inf))
        found = [PairDistance(a, b, d) for (a, b), d in nearest.items()]
        return sorted(found, key=lambda p: (p.distance_m, p.first, p.second))

    def touching_pairs(self, q: Array) -> set[frozenset[str]]:
        """Return the pairs that touch at q (14,)."""
        self.set_margin(0.0)
        self.contact_count(q)
        return {frozenset((c.first, c.second)) for c in self.contacts()}

    def closest(self, q: Array, within_m: float = _CLOSEST_WITHIN_M) -> list[PairDistance]:
        """Return every checked pair nearer than `within_m` at q (14,), nearest first."""
        before = self.margin_m
        self.set_margin(within_m)
        self.contact_count(q)
        found = self.contacts()
        self.set_margin(before)
        return found


def _boxes_to_meshes(spec: mujoco.MjSpec) -> None:
    """Give every box its eight corners as a mesh.

    MuJoCo's own test of two boxes reports no distance for most pairs that are apart, however large the margin; that
    of two meshes does.
    """
    corners = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    for index, geom in enumerate(spec.geoms):
        if geom.type == mujoco.mjtGeom.mjGEOM_BOX:
            mesh = spec.add_mesh(name=f"box_mesh{index}", uservert=(corners * geom.size).ravel())
            geom.type = mujoco.mjtGeom.mjGEOM_MESH
            geom.meshname = mesh.name
            geom.size = np.zeros(3)


def _add_body(spec: mujoco.MjSpec, parent: mujoco.MjsBody, shape: Shape) -> None:
    body = parent.add_body(name=shape.name, pos=list(shape.position_m), quat=list(shape.quat_wxyz))
    kind = mujoco.mjtGeom
    match shape:
        case Box():
            body.add_geom(type=kind.mjGEOM_BOX, size=[0.5 * v for v in shape.size_m])
        case Cylinder():
            body.add_geom(type=kind.mjGEOM_CYLINDER, size=[shape.radius_m, 0.5 * shape.length_m, 0.0])
        case Capsule():
            body.add_geom(type=kind.mjGEOM_CAPSULE, size=[shape.radius_m, 0.5 * shape.length_m, 0.0])
        case Sphere():
            body.add_geom(type=kind.mjGEOM_SPHERE, size=[shape.radius_m, 0.0, 0.0])
        case Mesh():
            for index, vertices in enumerate(shape.vertices()):
                name = f"{shape.name}:{index}"
                spec.add_mesh(name=name, uservert=vertices.ravel())
                body.add_geom(type=kind.mjGEOM_MESH, meshname=name)

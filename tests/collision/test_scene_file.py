"""Scene files and meshes: what is written is what both engines see, and what is wrong is named with its line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from minidual.collision.engines import CoalEngine, MujocoEngine
from minidual.collision.errors import GoalInCollisionError, StartInCollisionError
from minidual.collision.scene import PlanningScene
from minidual.collision.scene_file import load_mesh, load_scene
from minidual.collision.shapes import Box, Capsule, Cylinder, Mesh, Sphere, grown
from minidual.errors import ConfigError, DataError, MinidualError, UsageError
from minidual.motion.api import Planner
from minidual.motion.goal import Goal, load_goal
from minidual.motion.goal_plan import GoalPlanner
from minidual.robot.kinematics import Kinematics
from tests.support.panda import HOME, Q_LOWER, Q_UPPER

EXAMPLES = Path(__file__).parents[2] / "examples"

SCENE = """\
min_distance_m: 0.01
obstacles:
  - {name: post, shape: box, position_m: [0.36, 0.25, 0.4], size_m: [0.06, 0.06, 0.8]}
  - name: part
    shape: mesh
    file: part.stl
    scale: 0.001
    position_m: [0.6, 0.0, 0.2]
    rpy_rad: [0, 0, 0.5]
allowed:
  - {pair: [post, left_panda_leftfinger], reason: the post is soft}
checked:
  - [left_panda_link5, left_panda_link6]
"""


@pytest.fixture
def folder(tmp_path):
    trimesh.creation.box((100, 50, 80)).export(tmp_path / "part.stl")
    (tmp_path / "broken.stl").write_text("solid nothing\nendsolid")
    (tmp_path / "rubbish.obj").write_bytes(b"\x00\x01 this is no mesh")
    trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]).export(tmp_path / "flat.stl")
    (tmp_path / "notes.txt").write_text("a mesh, believe me")
    return tmp_path


def load(folder, text):
    path = folder / "bench.yaml"
    path.write_text(text)
    return load_scene(path)


def test_the_file_is_what_the_scene_holds(folder):
    scene, notes = load(folder, SCENE)
    assert [o.name for o in scene.obstacles] == ["table", "post", "part"]
    assert scene.obstacles[1] == Box("post", (0.36, 0.25, 0.4), size_m=(0.06, 0.06, 0.8))
    part = scene.obstacles[2]
    assert np.allclose(
        part.T_parent_shape[:2, :2],
        [[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]],
    )
    assert part.lengths() == pytest.approx((0.1, 0.05, 0.08))
    assert scene.min_distance_m == 0.01
    assert scene.why_unchecked("post", "left_panda_leftfinger") == "the post is soft"
    assert ("left_panda_link5", "left_panda_link6") in scene.checked_pairs
    assert "1.00 times its volume" in notes[0]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "size_m: [0.06",
            "size: [0.06",
            r"bench.yaml:3: obstacles.0.size: no such key; obstacles.0 has .*size_m",
        ),
        ("shape: box", "shape: bocks", r"bench.yaml:3: obstacles.0: .*'bocks'.*'box', 'cylinder'"),
        (
            "part.stl",
            "gone.stl",
            r"bench.yaml:4: obstacles.1: mesh 'part': .*gone.stl does not exist",
        ),
        (
            "part.stl",
            "broken.stl",
            r"obstacles.1: mesh 'part': broken.stl (does not load|holds no triangles)",
        ),
        (
            "part.stl",
            "rubbish.obj",
            r"obstacles.1: mesh 'part': rubbish.obj (does not load|holds no triangles)",
        ),
        ("part.stl", "flat.stl", r"obstacles.1: mesh 'part' \(flat.stl\) is flat"),
        ("part.stl", "notes.txt", r"extension '.txt'; known are .stl"),
        (
            "scale: 0.001",
            "scale: 1.0",
            r"measures 100 x 50 x 80 m at scale 1; .*from 0.0001 to 10.0 m",
        ),
        ("name: part", "name: post", r"bench.yaml:4: obstacles.1: .*'post' twice"),
        ("[post, left", "[pots, left", r"bench.yaml:11: allowed.0: no link or obstacle 'pots'"),
        (
            "[0.06, 0.06",
            "[0.06, -0.06",
            r"bench.yaml:3: obstacles.0.size_m.1: must be .*0.0001, is -0.06",
        ),
        (
            "[0.06, 0.06",
            "[0.06, 1.0e-7",
            r"bench.yaml:3: obstacles.0.size_m.1: must be .*0.0001, is 1e-07",
        ),
        (
            "rpy_rad: [0, 0, 0.5]",
            "rpy_rad: [0, 0, nan]",
            r"bench.yaml:9: .*nan is not a finite number",
        ),
        (
            "rpy_rad: [0, 0, 0.5]",
            "quat_wxyz: [1, 1, 0, 0]",
            r"obstacles.1: quat_wxyz has length 1.4142",
        ),
        (
            "rpy_rad: [0, 0, 0.5]",
            "quat_wxyz: [1, 0, 0, 0]\n    rpy_rad: [0, 0, 0]",
            "two ways to say one thing",
        ),
        (
            "obstacles:",
            "min_distance_m: 0.0\nobstacles:",
            r"bench.yaml:2: min_distance_m: stands twice",
        ),
        (
            "link5, left_panda_link6",
            "link1, left_panda_link6",
            r"bench.yaml:13: checked.0: .*checked already",
        ),
    ],
)
def test_what_is_wrong_is_named_with_its_line(folder, old, new, says):
    assert old in SCENE
    with pytest.raises(MinidualError) as caught:
        load(folder, SCENE.replace(old, new))
    assert caught.match(says)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("text", ["", "# nothing but a remark\n"])
def test_an_empty_file_is_named(folder, text):
    with pytest.raises(ConfigError, match=r"bench.yaml: the scene file is empty"):
        load(folder, text)


def test_the_example_scene_is_planned_in():
    scene = load_scene(EXAMPLES / "bench-scene.yaml")[0]
    assert {"post", "pipe", "bracket", "cup"} < set(scene.names)
    planner = GoalPlanner(Planner(scene))
    start = planner.start_joints("both_arms", HOME, load_goal(EXAMPLES / "beside-post.yaml"))
    plan = planner.plan("left_arm", start, Goal(state="ready"), seed=1)
    assert plan.verification.ok
    assert not plan.direct  # the post stands in the way
    assert planner.plan(
        "left_arm",
        start,
        Goal(state="ready"),
        scene=PlanningScene(),
        seed=1,
    ).direct


def test_both_engines_agree_on_meshes_and_grown_shapes():
    bracket = load_mesh(
        EXAMPLES / "bracket.obj",
        "bracket",
        (0.5, 0.1, 0.3),
        scale=0.003,
        separate=True,
    )[0]
    scene = PlanningScene().with_obstacles(
        bracket,
        Cylinder("pipe", (0.4, -0.3, 0.4), radius_m=0.05, length_m=0.5),
    )
    Q = np.random.default_rng(3).uniform(Q_LOWER, Q_UPPER, (1500, 14))
    for asked in (scene, replace(scene, min_distance_m=0.03)):
        mujoco = MujocoEngine(asked)
        coal = CoalEngine(asked)
        hits = mujoco.collisions(Q)
        assert (hits == coal.collisions(Q)).all()
        touched = sum(any("bracket" in pair for pair in mujoco.touching_pairs(q)) for q in Q[:300])
        assert 10 < touched < 290


def in_pieces(points, mesh):
    inside = np.zeros(len(points), dtype=bool)
    for vertices in mesh.vertices():
        hull = ConvexHull(vertices)
        inside |= (points @ hull.equations[:, :3].T + hull.equations[:, 3] <= 1e-7).all(axis=1)
    return inside


@pytest.mark.parametrize("separate", [False, True])
def test_convex_hulls_cover_the_whole_mesh(tmp_path, separate):
    """Oracle: points inside two spheres must lie in a hull; between them only if one hull covers both."""
    centres = np.array([[0.1, 0.0, 0.0], [-0.1, 0.02, 0.05]])
    balls = [
        trimesh.creation.icosphere(subdivisions=3, radius=0.05).apply_translation(c)
        for c in centres
    ]
    trimesh.util.concatenate(balls).export(tmp_path / "balls.obj")
    mesh, note = load_mesh(tmp_path / "balls.obj", "balls", (0, 0, 0), separate=separate)
    ways = np.random.default_rng(0).normal(size=(2000, 3))
    ways *= 0.049 / np.linalg.norm(ways, axis=1, keepdims=True)
    assert in_pieces((centres[:, None] + ways).reshape(-1, 3), mesh).all()
    assert in_pieces(centres.mean(axis=0)[None], mesh)[0] == (not separate)
    assert f"{1 + separate} convex pieces" in note
    assert ("1.00 times" in note) == separate


def test_a_flat_piece_and_too_many_pieces_are_refused(tmp_path):
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    sheet = trimesh.Trimesh([[1, 0, 0], [2, 0, 0], [1, 1, 0]], [[0, 1, 2]])
    trimesh.util.concatenate([box, sheet]).export(tmp_path / "sheet.obj")
    assert load_mesh(tmp_path / "sheet.obj", "s", (0, 0, 0))[0].pieces
    with pytest.raises(DataError, match="has a flat piece"):
        load_mesh(tmp_path / "sheet.obj", "s", (0, 0, 0), separate=True)
    many = [
        trimesh.creation.box((0.01,) * 3).apply_translation((0.02 * k, 0, 0)) for k in range(65)
    ]
    trimesh.util.concatenate(many).export(tmp_path / "many.obj")
    with pytest.raises(UsageError, match="has 65 pieces; at most 64"):
        load_mesh(tmp_path / "many.obj", "m", (0, 0, 0), separate=True)


def test_bad_meshes_by_code(tmp_path):
    with pytest.raises(UsageError, match="at least one convex piece"):
        Mesh("m", (0, 0, 0))
    (tmp_path / "bad.off").write_text("OFF\nthree\n")
    with pytest.raises(DataError, match="does not load"):
        load_mesh(tmp_path / "bad.off", "b", (0, 0, 0))


@pytest.mark.parametrize(
    "shape",
    [
        Box("s", (0.1, 0.2, 0.3), size_m=(0.1, 0.2, 0.3)),
        Cylinder("s", (0, 0, 0), radius_m=0.05, length_m=0.2),
        Capsule("s", (0, 0, 0), radius_m=0.05, length_m=0.2),
        Sphere("s", (0, 0, 0), radius_m=0.1),
        Mesh("s", (0, 0, 0), pieces=(np.eye(4, 3).tobytes(),)),
    ],
)
def test_a_grown_shape_holds_all_that_is_near(shape):
    """Every point nearer than the distance is inside: extents grow by it on both sides at least."""
    bigger = grown(shape, 0.02)
    assert grown(shape, 0.0) is shape
    if isinstance(shape, Mesh):
        for a, b in zip(shape.vertices(), bigger.vertices(), strict=True):
            assert (np.ptp(b, axis=0) >= np.ptp(a, axis=0) + 0.04 - 1e-12).all()
            ball = np.random.default_rng(0).normal(size=(200, 3))
            ball *= 0.02 / np.linalg.norm(ball, axis=1)[:, None]
            hull = ConvexHull(b)
            assert (
                np.vstack([p + ball for p in a]) @ hull.equations[:, :3].T + hull.equations[:, 3]
                < 1e-9
            ).all()
    elif isinstance(shape, Box):
        assert bigger.size_m == pytest.approx([v + 0.04 for v in shape.size_m])
    else:
        assert bigger.radius_m == pytest.approx(shape.radius_m + 0.02)


def test_the_distance_to_keep_changes_what_plans():
    x, y, z = Kinematics().tcp_poses(HOME)[0][:3, 3]
    scene = PlanningScene().with_obstacles(Box("shelf", (x, y, z - 0.1), size_m=(0.2, 0.2, 0.12)))
    gap = MujocoEngine(scene).closest(HOME, 0.1)
    gap_m = next(p.distance_m for p in gap if "shelf" in (p.first, p.second))
    start = HOME.copy()
    start[3] += 0.4
    planner = Planner()
    asked = replace(scene, min_distance_m=gap_m - 0.002)
    plan = planner.plan_to_joints("left_arm", start, HOME, scene=asked, seed=1)
    plain = MujocoEngine(scene)
    nearest = min(
        p.distance_m
        for q in plan.trajectory.q[::20]
        for p in plain.closest(q, 0.1)
        if "shelf" in (p.first, p.second)
    )
    assert nearest >= gap_m - 0.002 - 1e-6
    with pytest.raises(GoalInCollisionError, match=r"shelf.*keeps .* mm"):
        planner.plan_to_joints(
            "left_arm",
            start,
            HOME,
            scene=replace(scene, min_distance_m=gap_m + 0.002),
        )
    for bad in (-0.01, float("nan"), 1.0):
        with pytest.raises(UsageError, match="min_distance_m"):
            replace(scene, min_distance_m=bad)


def test_a_pair_in_the_file_changes_what_plans_both_ways(folder):
    x, y, z = Kinematics().tcp_poses(HOME)[0][:3, 3]
    foam = f"obstacles:\n  - {{name: foam, shape: box, position_m: [{x}, {y}, {z - 0.05}], size_m: [0.3, 0.3, 0.11]}}\n"
    allow = "allowed:\n" + "".join(
        f"  - {{pair: [foam, left_panda_{finger}], reason: foam is soft}}\n"
        for finger in ("leftfinger", "rightfinger")
    )
    start = HOME.copy()
    start[3] += 0.4
    planner = Planner()
    with pytest.raises(GoalInCollisionError, match="foam"):
        planner.plan_to_joints("left_arm", start, HOME, scene=load(folder, foam)[0])
    assert planner.plan_to_joints(
        "left_arm",
        start,
        HOME,
        scene=load(folder, foam + allow)[0],
    ).verification.ok
    check = "checked:\n  - [left_panda_link5, left_panda_link6]\n"
    with pytest.raises(StartInCollisionError, match="left_panda_link5 and left_panda_link6"):
        planner.plan_to_joints("left_arm", start, HOME, scene=load(folder, foam + allow + check)[0])


def test_a_held_object_of_the_file_moves_with_its_hand(folder):
    text = """\
obstacles:
  - name: stick
    shape: capsule
    position_m: [0, 0, 0.2]
    radius_m: 0.01
    length_m: 0.4
    held: {link: left_panda_hand_tcp}
"""
    scene = load(folder, text)[0]
    planner = GoalPlanner(Planner(scene))
    ready = planner.states.joints("ready", "left_arm", HOME)
    # The stick hangs 41 cm under a hand that is 25 cm over the table.
    with pytest.raises(GoalInCollisionError, match=r"stick and table|table and stick"):
        planner.plan("left_arm", HOME, Goal(state="ready"))
    assert MujocoEngine(PlanningScene()).touching_pairs(ready) == set()
    with pytest.raises(UsageError, match=r"bench.yaml:2: obstacles.0: no link 'left_hand'"):
        load(folder, text.replace("left_panda_hand_tcp", "left_hand"))

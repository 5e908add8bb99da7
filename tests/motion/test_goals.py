"""Named states, every kind of goal, and straight moves with the fraction achieved."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from pydantic import ValidationError

from minidual.collision.engines import MujocoEngine
from minidual.collision.errors import (
    GoalInCollisionError,
    IKUnreachableError,
    LinearMoveError,
    OutOfLimitsError,
)
from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Box
from minidual.config.planning import MotionLimits, PlannerConfig
from minidual.config.scene import NamedStateConfig, SemanticsConfig
from minidual.errors import ConfigError, DataError, MinidualError, UsageError
from minidual.motion.api import Planner
from minidual.motion.goal import Goal, Move, Poses, TipOffset, TipPose, goal_of, load_goal
from minidual.motion.goal_plan import GoalPlanner
from minidual.motion.linear import Line, LinearPlanner
from minidual.motion.pose_goals import pose_goals
from minidual.motion.states import NamedStates
from minidual.robot.kinematics import Kinematics
from minidual.robot.models import ARM_MODELS
from minidual.robot.pair import DUAL_PANDA, Robot, pose, rot_x

HOME = DUAL_PANDA.home
Q_LOWER = DUAL_PANDA.q_lower
Q_UPPER = DUAL_PANDA.q_upper
EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def planner():
    return GoalPlanner(Planner())


@pytest.fixture(scope="module")
def ready():
    return NamedStates().joints("ready", "both_arms", HOME)


def to_pose(position_m, quat_wxyz=None, frame="world", arm="left"):
    return Goal(
        poses=Poses(**{arm: TipPose(position_m=position_m, quat_wxyz=quat_wxyz, frame=frame)}),
    )


def by(offset_m=(0.0, 0.0, 0.0), rotation_rad=(0.0, 0.0, 0.0), frame="world", arm="left", **how):
    return Goal(
        move=Move(frame=frame, **{arm: TipOffset(offset_m=offset_m, rotation_rad=rotation_rad)}),
        **how,
    )


def tips(q):
    return dict(zip(("left", "right"), Kinematics().tcp_poses(q), strict=True))


def test_every_named_state_is_inside_the_limits_and_free():
    states = NamedStates()
    engine = MujocoEngine(PlanningScene())
    assert {"home", "ready", "carry", "raised", "folded"} <= set(states)
    for name in states:
        q = states.joints(name, "both_arms", HOME)
        assert ((q > Q_LOWER) & (q < Q_UPPER)).all()
        assert not engine.touching_pairs(q), name
    assert (states.joints("home", "both_arms", np.zeros(14)) == HOME).all()


def test_a_state_of_one_arm_leaves_the_other():
    states = NamedStates(
        SemanticsConfig(states={"wave": NamedStateConfig(left_rad=(0.1, 0, 0, -1.5, 0, 1.5, 0))}),
    )
    assert {"wave", "home"} <= set(states)  # the arm model's own stay
    q = states.joints("wave", "left_arm", HOME)
    assert q[0] == 0.1
    assert (q[7:] == HOME[7:]).all()
    with pytest.raises(
        UsageError,
        match="'wave' says nothing about the right arm, which both_arms moves",
    ):
        states.joints("wave", "both_arms", HOME)


def test_states_come_from_the_arm_model():
    six = Robot(ARM_MODELS["ur5"])
    states = NamedStates(robot=six)
    assert (states.joints("home", "both_arms", np.zeros(12)) == six.home).all()
    with pytest.raises(ConfigError, match=r"states.x.left_rad: 7 values; the arm has 6 joints"):
        NamedStates(SemanticsConfig(states={"x": NamedStateConfig(left_rad=(0.0,) * 7)}), six)


@pytest.mark.parametrize(
    ("state", "says"),
    [
        (NamedStateConfig(left_rad=(0.0,) * 6), r"states.x.left_rad: 6 values; the arm has 7"),
        (NamedStateConfig(), "neither left_rad nor right_rad"),
        (NamedStateConfig(right_rad=(0.0,) * 7), r"right_panda_joint4 = 0 rad; its limits"),
    ],
)
def test_states_that_do_not_fit_the_robot_are_refused(state, says):
    with pytest.raises(ConfigError, match=says):
        NamedStates(SemanticsConfig(states={"x": state}))


def test_one_hand_moves_to_a_pose_and_the_other_stays(planner, ready):
    goal = to_pose((0.5, 0.3, 0.3))
    resolved = planner.resolve("both_arms", ready, goal)
    before = tips(ready)
    assert np.abs(resolved["right"] - before["right"]).max() < 1e-12
    assert np.abs(resolved["left"][:3, :3] - before["left"][:3, :3]).max() < 1e-12
    plan = planner.plan("both_arms", ready, goal, seed=1)
    after = tips(plan.trajectory.q[-1])
    assert np.abs(after["left"][:3, 3] - (0.5, 0.3, 0.3)).max() < 1e-6
    assert np.abs(after["right"] - before["right"]).max() < 1e-6


def test_frames_are_the_world_links_obstacles_and_held_objects(planner):
    T = pose(rot_x(0.4), (0.5, 0.2, 0.3))
    quat = pin.Quaternion(T[:3, :3])
    scene = PlanningScene().with_obstacles(
        Box("shelf", (0.5, 0.2, 0.3), (quat.w, quat.x, quat.y, quat.z), size_m=(0.1, 0.1, 0.1)),
    )
    point = (0.1, 0.02, -0.03)
    goal = to_pose(point, (1.0, 0.0, 0.0, 0.0), "shelf")
    target = planner.resolve("left_arm", HOME, goal, scene)["left"]
    assert np.abs(target - T @ pose(np.eye(3), point)).max() < 1e-12
    own = to_pose((0.0, 0.0, 0.05), (1.0, 0.0, 0.0, 0.0), "left_panda_hand_tcp")
    ahead = planner.resolve("left_arm", HOME, own)["left"]
    assert np.abs(ahead - tips(HOME)["left"] @ pose(np.eye(3), (0, 0, 0.05))).max() < 1e-12
    with pytest.raises(UsageError, match=r"no frame 'shelv'.*shelf") as caught:
        planner.resolve("left_arm", HOME, to_pose(point, None, "shelv"), scene)
    assert caught.value.remedy == "did you mean 'shelf'?"


@pytest.mark.parametrize("frame", ["world", "tcp"])
def test_relative_goals_in_both_frames(planner, ready, frame):
    offset = TipOffset(offset_m=(0.02, -0.03, 0.05), rotation_rad=(0.1, 0.0, 0.4))
    before = tips(ready)["right"]
    target = planner.resolve("right_arm", ready, Goal(move=Move(right=offset, frame=frame)))[
        "right"
    ]
    turn = pin.exp3(np.array(offset.rotation_rad))
    if frame == "tcp":
        wanted = before @ pose(turn, offset.offset_m)
    else:
        wanted = pose(turn @ before[:3, :3], before[:3, 3] + offset.offset_m)
    assert np.abs(target - wanted).max() < 1e-12


def test_some_joints_by_name(planner):
    resolved = planner.resolve(
        "left_arm",
        HOME,
        Goal(joints_by_name_rad={"left_panda_joint1": 0.4}),
    )
    assert resolved[0] == 0.4
    assert (resolved[1:] == HOME[1:]).all()


@pytest.mark.parametrize(
    ("group", "goal", "kind", "says"),
    [
        (
            "left_arm",
            Goal(state="redy"),
            UsageError,
            "no named state 'redy'; there are carry, folded",
        ),
        ("left_arms", Goal(state="ready"), UsageError, "no group 'left_arms'"),
        (
            "left_arm",
            Goal(joints_by_name_rad={"left_panda_joint9": 0.1}),
            UsageError,
            "no joint 'left_panda_joint9'",
        ),
        (
            "left_arm",
            Goal(joints_by_name_rad={"right_panda_joint1": 0.1}),
            UsageError,
            "moves joints outside left_arm",
        ),
        (
            "left_arm",
            Goal(joints_by_name_rad={"left_panda_joint4": 0.5}),
            OutOfLimitsError,
            "left_panda_joint4 = 0.5 rad",
        ),
        ("left_arm", Goal(joints_rad=(0.0,) * 5), OutOfLimitsError, r"shape \(5,\)"),
        ("left_arm", to_pose((0.5, 0.0, 0.3), arm="right"), UsageError, "left_arm moves left only"),
        ("left_arm", to_pose((1.5, 0.0, 0.3)), IKUnreachableError, r"cannot reach \(1.500"),
    ],
)
def test_bad_goals_are_named(planner, group, goal, kind, says):
    with pytest.raises(kind, match=says) as caught:
        planner.plan(group, HOME, goal)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(
    ("goal", "says"),
    [
        ({"poses": {"left": {"position_m": (0.5, float("nan"), 0.3)}}}, "finite number"),
        ({"joints_rad": (float("nan"),) * 7}, "finite number"),
        ({"poses": {"middle": {"position_m": (0.5, 0.0, 0.3)}}}, "middle"),
        ({"poses": {}}, "neither left nor right"),
        ({"move": {"left": {"offset_m": (float("inf"), 0, 0)}}}, "finite number"),
        ({"move": {"left": {}, "frame": "tool"}}, "'world' or 'tcp'"),
        ({"move": {"left": {}}, "linear": True, "fraction_min": 0.0}, "greater than 0"),
        ({"move": {"left": {}}, "linear": True, "fraction_min": 1.1}, "less than or equal to 1"),
    ],
)
def test_goals_that_mean_nothing_cannot_be_made(goal, says):
    with pytest.raises(ValidationError, match=says):
        Goal.model_validate(goal)


def test_a_straight_move_is_straight(planner, ready):
    """Oracle: forward kinematics at random times against the line and the turn about one axis."""
    left = TipOffset(offset_m=(0.1, 0.05, -0.12), rotation_rad=(0.0, 0.3, 0.5))
    goal = Goal(move=Move(left=left, right=TipOffset(offset_m=(0, 0, -0.1))), linear=True)
    move = LinearPlanner().plan(
        "both_arms",
        ready,
        planner.resolve("both_arms", ready, goal),
        planner.planner.engines(),
    )
    assert move.fraction == 1.0
    assert move.reason == ""
    assert move.verification.ok
    before = tips(ready)
    targets = planner.resolve("both_arms", ready, goal)
    Q, _, _ = move.trajectory.sample_many(
        np.random.default_rng(0).uniform(0, move.trajectory.duration_s, 300),
    )
    for arm in ("left", "right"):
        line = Line(before[arm], targets[arm])
        shift = targets[arm][:3, 3] - before[arm][:3, 3]
        for q in Q:
            T = tips(q)[arm]
            x = float((T[:3, 3] - before[arm][:3, 3]) @ shift / (shift @ shift))
            distance, angle = line.off(T, x)
            assert distance < 2e-4
            assert angle < 3e-3
        assert np.abs(tips(move.trajectory.q[-1])[arm] - targets[arm]).max() < 1e-5
    speeds = (
        np.linalg.norm(
            np.diff([tips(q)["left"][:3, 3] for q in move.trajectory.q[::10]], axis=0),
            axis=1,
        )
        / 0.01
    )
    assert speeds.max() < 0.26


def test_a_straight_move_tells_how_far_it_goes_and_why(planner, ready):
    into_table = by((0, 0, -0.5), linear=True)
    with pytest.raises(
        LinearMoveError,
        match=r"ends at 4\d.\d% of the way: collision: .*finger and table",
    ) as caught:
        planner.plan("left_arm", ready, into_table)
    assert caught.value.reason == "linear_blocked"
    part = by((0, 0, -0.5), linear=True, fraction_min=0.3)
    plan = planner.plan("left_arm", ready, part)
    fell = tips(ready)["left"][2, 3] - tips(plan.trajectory.q[-1])["left"][2, 3]
    targets = planner.resolve("left_arm", ready, part)
    move = LinearPlanner().plan(
        "left_arm",
        ready,
        targets,
        planner.planner.engines(),
        fraction_min=0.3,
    )
    assert 0.3 < move.fraction < 0.5
    assert fell == pytest.approx(0.5 * move.fraction, abs=1e-4)
    assert plan.verification.ok
    assert "the line covers" in plan.notes[0]
    with pytest.raises(LinearMoveError, match=r"would jump by|cannot go on"):
        planner.plan("left_arm", ready, by((1.0, 0, 0), linear=True))
    stay = planner.plan("left_arm", ready, by(linear=True))
    assert len(stay.trajectory.times) == 2


def test_a_straight_move_keeps_the_jerk_of_the_configuration(ready):
    """The share of the jerk limit is used where it binds, and a smaller one takes longer."""
    down = by((0, 0, -0.05), (0, 0, 0), linear=True)
    found = {}
    for scale in (0.95, 0.01):
        planner = GoalPlanner(Planner(config=PlannerConfig(jerk_scale=scale)))
        plan = planner.plan("left_arm", ready, down)
        assert plan.verification.jerk_ratio <= scale * 1.0001
        found[scale] = plan.trajectory.duration_s, plan.verification.jerk_ratio
    assert found[0.95][0] < found[0.01][0]
    assert found[0.95][1] > 2.0 * found[0.01][1]


def test_limits_are_given_by_name():
    with pytest.raises(TypeError):
        MotionLimits(0.95, 0.9, 0.95, 0.04)


def test_a_straight_move_of_no_length_is_proven_too(planner, ready):
    """Where the proof sees a box in the hand and the search does not, staying there is no plan."""
    hand = tuple(tips(ready)["left"][:3, 3])
    seen, far = (
        Planner(PlanningScene().with_obstacles(Box("box", at, size_m=(0.1, 0.1, 0.1)))).engines()
        for at in (hand, (3.0, 0.0, 0.0))
    )
    targets = {"left": tips(ready)["left"]}
    assert LinearPlanner().plan("left_arm", ready, targets, far).verification.ok
    far.verify = seen.verify
    with pytest.raises(LinearMoveError, match="staying there is not proven: collision"):
        LinearPlanner().plan("left_arm", ready, targets, far)


def test_example_goal_files(planner, ready):
    down = load_goal(EXAMPLES / "straight-down.yaml")
    left = TipOffset(offset_m=(0, 0, -0.1), rotation_rad=(0, 0, 0.5))
    assert down == Goal(move=Move(left=left, right=TipOffset(offset_m=(0, 0, -0.1))), linear=True)
    assert planner.plan("both_arms", ready, down).verification.ok
    over = load_goal(EXAMPLES / "over-the-bracket.yaml")
    assert over.poses.right.frame == "bracket"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "goal.yaml: the goal file is empty"),
        ("state: ready\njoints_rad: [1]\n", "holds state and joints_rad; give one of state"),
        ("linear: true\n", "holds no goal"),
        ("state: ready\nlinear: true\n", "linear goes with poses or move, not with state"),
        ("poses: {left: {position_m: [0, 0]}}\n", r"goal.yaml:1: poses.left.position_m"),
        ("poses: {}\n", "poses names neither left nor right"),
        ("poses:\n  left: {position_m: [0, 0, .nan]}\n", r"goal.yaml:2: .*not a finite number"),
        (
            "move: {left: {ofset_m: [0, 0, 0]}}\n",
            r"move.left.ofset_m: no such key; move.left has offset_m",
        ),
        ("state: a\nstate: b\n", "stands twice"),
        ("move: {left: {}}\nfraction_min: 0.5\n", "fraction_min goes with linear"),
    ],
)
def test_bad_goal_files_are_named(tmp_path, text, says):
    path = tmp_path / "goal.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=says):
        load_goal(path)


def test_words_and_files(tmp_path, planner, ready):
    names = planner.states
    assert goal_of("carry", names) == Goal(state="carry")
    with pytest.raises(UsageError, match=r"no named state 'cary'.*a file ends in .yaml or .json"):
        goal_of("cary", names)
    with pytest.raises(UsageError, match="there is no file"):
        goal_of("nowhere.yaml", names)
    plan = planner.plan("left_arm", HOME, Goal(joints_by_name_rad={"left_panda_joint1": 0.2}))
    plan.trajectory.write_json(tmp_path / "t.json", DUAL_PANDA.joint_names)
    again = goal_of(str(tmp_path / "t.json"), names)
    assert (
        np.abs(np.array(list(again.joints_by_name_rad.values())) - plan.trajectory.q[-1]).max()
        < 1e-8
    )
    (tmp_path / "t.json").write_text('{"joint_names": ["left_join1"], "q_rad": [[0]]}')
    with pytest.raises(UsageError, match="no joint 'left_join1'; there are left_panda_joint1"):
        planner.plan("left_arm", HOME, goal_of(str(tmp_path / "t.json"), names))
    for bad in ("[]", "{", '{"joint_names": ["a", "b"], "q_rad": [[0]]}'):
        (tmp_path / "t.json").write_text(bad)
        with pytest.raises(DataError, match=r"t\.json"):
            goal_of(str(tmp_path / "t.json"), names)


def test_poses_as_a_start(planner):
    q = planner.start_joints("left_arm", HOME, to_pose((0.5, 0.3, 0.3)))
    assert np.abs(tips(q)["left"][:3, 3] - (0.5, 0.3, 0.3)).max() < 1e-6
    assert (q[7:] == HOME[7:]).all()
    with pytest.raises(MinidualError):
        planner.start_joints("left_arm", HOME, to_pose((0.5, 0.3, -0.3)))


class _NeverProvenFree:
    """Engines for which nothing is free, although no pair touches."""

    scene = PlanningScene()

    def __init__(self):
        self.solids = self

    def free(self, q):
        return False

    def closest(self, q, within_m):
        return []


def test_a_goal_that_no_plane_separates_is_refused_and_not_searched_for_ever():
    home = DUAL_PANDA.home
    target = Kinematics(DUAL_PANDA).tcp_poses(home)[0]
    with pytest.raises(GoalInCollisionError, match="too close to contact"):
        pose_goals(
            "left_arm",
            home,
            {"left": target},
            _NeverProvenFree(),
            np.random.default_rng(0),
            2,
        )

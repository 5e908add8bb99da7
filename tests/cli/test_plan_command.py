"""`minidual plan --to` and `--acm`: one motion without a gate, whole files, no verdict."""

import csv
import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest

from minidual.cli.app import run_command_line
from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Box, Capsule, Cylinder, Mesh, Sphere
from minidual.motion.api import Planner
from minidual.proof.scene_engines import CLEARANCE_MAX_M
from minidual.robot.kinematics import Kinematics
from minidual.robot.trajectory import Trajectory
from minidual.show.planning import Poser, play
from minidual.show.watch import tcp_preview
from minidual.stages.plan_once import clearance_text
from minidual.stages.registry import STAGES
from tests.support.panda import HOME, JOINT_NAMES

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def run(tmp_path, capsys):
    def call(*words):
        code = run_command_line(
            ["plan", *map(str, words), "--runs-dir", str(tmp_path / "runs")],
            STAGES,
        )
        out = capsys.readouterr()
        assert not list(tmp_path.rglob("verdict.json"))
        return code, out.out, out.err

    return call


def test_a_plan_prints_its_summary_and_writes_its_files(run, tmp_path):
    code, out, err = run(
        "--group",
        "both_arms",
        "--to",
        "ready",
        "--out",
        tmp_path / "t.json",
        "--csv",
        tmp_path / "t.csv",
    )
    assert code == 0
    for word in (
        "both_arms to ready",
        "phases [ms]",
        "clearance",
        "of limits",
        "velocity",
        "joint margin",
    ):
        assert word in out
    assert "t.json" in err
    written = json.loads((tmp_path / "t.json").read_text())
    assert written["joint_names"] == list(JOINT_NAMES)
    with (tmp_path / "t.csv").open() as file:
        rows = list(csv.reader(file))
    assert len(rows) - 1 == len(written["times_s"])
    assert np.allclose([float(v) for v in rows[-1][1:15]], written["q_rad"][-1], atol=1e-8)
    # The end of one plan is the start of the next.
    code, out, _ = run("--from", tmp_path / "t.json", "--to", "home", "--json")
    assert code == 0
    document = json.loads(out)
    assert document["solved"]
    assert document["proof"]["ok"]
    assert np.allclose(document["q_goal_rad"], HOME)


def test_a_plan_timed_by_toppra_says_what_is_not_limited(run):
    words = ("--to", "ready", "--set", "plan.planner.timing=toppra")
    code, out, _ = run(*words)
    assert code == 0
    assert "not limited   jerk, torque rate" in out
    _, out, _ = run(*words, "--json")
    assert json.loads(out)["proof"]["reported_only"] == ["jerk", "torque_rate"]


def test_the_same_seed_gives_the_same_plan(run):
    words = (
        "--scene",
        EXAMPLES / "bench-scene.yaml",
        "--group",
        "left_arm",
        "--from",
        EXAMPLES / "beside-post.yaml",
        "--to",
        "ready",
        "--json",
    )
    digests = {json.loads(run(*words, "--seed", seed)[1])["digest"] for seed in (1, 1)}
    assert len(digests) == 1


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--to", "redy"), "did you mean 'ready'?"),
        (("--to", "ready", "--set", "plan.planner.timing=topra"), "did you mean 'toppra'?"),
        (("--to", "ready", "--group", "both"), "no group 'both'"),
        (("--to", "ready", "--from", "nowhere.yaml"), "there is no file nowhere.yaml"),
        (("--to", "ready", "--scene", "nowhere.yaml"), "nowhere.yaml"),
        (("--to", "ready", "--out", "t.txt"), "--out t.txt must end in .json"),
        (("--to", "ready", "--csv", "no/such/folder/t.csv"), "there is no folder no/such/folder"),
        (("--to", "ready", "--budget-s", "0"), "--budget-s is 0"),
        (("--group", "left_arm"), "--group goes with --to"),
        (("--scene", "x.yaml"), "--scene goes with --acm or --to"),
        (("--to", "ready", "--view", "webb"), "no view 'webb'"),
    ],
)
def test_what_is_typed_wrongly_ends_with_2(run, words, says):
    code, out, err = run(*words)
    assert code == 2
    assert out == ""
    assert says in err


def test_files_that_cannot_be_written_are_refused(run, tmp_path, monkeypatch):
    """A wrong path is refused before anything is planned.

    A disk that fills up afterwards ends with exit code 4.
    """
    folder = tmp_path / "folder.json"
    folder.mkdir()
    code, out, err = run("--to", "ready", "--out", folder)
    assert (code, out) == (2, "")
    assert "folder.json is a folder" in err
    if os.geteuid() != 0:  # nothing is forbidden to root
        locked = tmp_path / "locked.json"
        locked.touch(mode=0o400)
        code, out, err = run("--to", "ready", "--out", locked)
        assert (code, out) == (2, "")
        assert "locked.json cannot be written: no permission" in err

    def full(*_args, **_more):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Trajectory, "write_csv", full)
    code, _, err = run("--to", "ready", "--csv", tmp_path / "t.csv")
    assert code == 4
    assert f"no space left on the disk of {tmp_path / 't.csv'}" in err


def test_a_plan_far_from_everything_has_at_least_the_largest_clearance():
    assert clearance_text(CLEARANCE_MAX_M, 0.0) == "at least 40.0 mm"
    assert clearance_text(0.0312, 0.0) == "31.2 mm"
    arms_only = Planner(PlanningScene(obstacles=()))
    goal = HOME.copy()
    goal[6] += 0.01
    plan = arms_only.plan_to_joints("left_arm", HOME, goal)
    assert 0.0 < arms_only.engines().clearance(plan.trajectory) <= CLEARANCE_MAX_M


def test_bad_queries_end_with_2_and_no_way_with_1(run, tmp_path):
    unreachable = tmp_path / "far.yaml"
    unreachable.write_text("poses: {left: {position_m: [1.5, 0, 0.3]}}")
    code, _, err = run("--group", "left_arm", "--to", unreachable)
    assert code == 2
    assert "cannot reach (1.500, 0.000, 0.300)" in err
    down = tmp_path / "down.yaml"
    down.write_text("move: {left: {offset_m: [0, 0, -0.5]}}\nlinear: true\n")
    code, out, _ = run("--group", "left_arm", "--from", "ready", "--to", down, "--json")
    assert code == 1
    document = json.loads(out)
    assert not document["solved"]
    assert document["reason"] == "linear_blocked"
    assert "of the way" in document["message"]
    wall = tmp_path / "wall.yaml"
    wall.write_text(
        "obstacles:\n"
        "  - {name: wall, shape: box, position_m: [0.5, 0.25, 0.5], size_m: [0.02, 1.0, 1.0]}\n",
    )
    code, _, err = run("--scene", wall, "--group", "left_arm", "--from", "folded", "--to", "ready")
    assert code == 2
    assert "goal is in collision" in err


def test_no_path_within_the_budget_ends_with_1(run, tmp_path):
    """Walls between both ends, and less time than it takes to look at the scene."""
    scene = tmp_path / "walls.yaml"
    scene.write_text(
        "obstacles:\n"
        "  - {name: fence, shape: box, position_m: [0.6, 0.25, 0.9], size_m: [0.9, 0.02, 1.8]}\n"
        "  - {name: back, shape: box, position_m: [-0.6, 0.25, 0.9], size_m: [0.9, 0.02, 1.8]}\n",
    )
    starts = {}
    for name, turn in (("a", 1.4), ("b", -1.4)):
        starts[name] = tmp_path / f"{name}.yaml"
        starts[name].write_text(f"joints_by_name_rad: {{left_panda_joint1: {turn}}}\n")
    code, out, err = run(
        "--scene",
        scene,
        "--group",
        "left_arm",
        "--from",
        starts["a"],
        "--to",
        starts["b"],
        "--budget-s",
        0.001,
    )
    assert code == 1
    assert "no proven path for left_arm in 0.00 s" in out
    assert "remedy" in err


def test_acm_prints_pairs_and_reasons(run, tmp_path):
    code, out, err = run("--acm")
    assert code == 0
    assert any(
        line.split()[:3] == ["left_panda_link5", "left_panda_link6", "adjacent"]
        for line in out.splitlines()
    )
    assert "pairs of different arms always are" in err
    assert "converged" in err
    kinds = {line.split()[2] for line in out.splitlines()}
    assert kinds == {line.split()[1] for line in err.splitlines() if line.split()[0].isdigit()} - {
        "pairs",
    }
    assert "allowed by the scene file" not in err
    document = json.loads(run("--acm", "--json")[1])
    assert len(document["allowed"]) == len(out.splitlines())
    assert document["built"]["converged"]
    scene = tmp_path / "s.yaml"
    scene.write_text(
        "obstacles:\n  - {name: foam, shape: sphere, position_m: [1, 1, 1], radius_m: 0.1}\n"
        "allowed:\n  - {pair: [foam, left_panda_hand], reason: soft}\n"
        "checked:\n  - [left_panda_link5, left_panda_link6]\n",
    )
    laid = json.loads(run("--acm", "--scene", scene, "--json")[1])
    pairs = {(p["first"], p["second"]): p["reason"] for p in laid["allowed"]}
    assert pairs["foam", "left_panda_hand"] == "soft"
    assert ("left_panda_link5", "left_panda_link6") not in pairs
    assert ["left_panda_link5", "left_panda_link6"] in laid["checked"]


@pytest.fixture(scope="module")
def swing():
    t = np.linspace(0.0, 0.2, 201)
    x = (t / 0.2) ** 2 * (3 - 2 * t / 0.2)
    q = np.tile(HOME, (201, 1))
    q[:, 0] += 0.3 * x
    v = np.gradient(q, t, axis=0)
    return Trajectory(t, q, v, np.gradient(v, t, axis=0), "left_arm")


@pytest.fixture(scope="module")
def furnished():
    return PlanningScene().with_obstacles(
        Box("b", (0.6, 0, 0.1), size_m=(0.1, 0.1, 0.2)),
        Cylinder("c", (0.6, 0.3, 0.1)),
        Capsule("k", (0.6, -0.3, 0.2)),
        Sphere("s", (0.8, 0, 0.3)),
        Mesh("m", (0.8, 0.3, 0.1), pieces=((0.1 * np.eye(4, 3)).tobytes(),)),
    )


@pytest.mark.parametrize(
    ("write", "broken"),
    [(Trajectory.write_csv, "numpy.savetxt"), (Trajectory.write_json, "pathlib.Path.write_text")],
)
def test_a_file_cut_off_is_no_shorter_trajectory(swing, tmp_path, monkeypatch, write, broken):
    """The earlier file stays until the new one is whole."""
    path = tmp_path / "trajectory"
    write(swing, path, JOINT_NAMES)
    whole = path.read_bytes()

    def cut_off(*given, **_more):
        (file,) = (word for word in given if isinstance(word, Path))
        file.write_bytes(whole[: len(whole) // 2])
        raise KeyboardInterrupt

    monkeypatch.setattr(broken, cut_off)
    with pytest.raises(KeyboardInterrupt):
        write(swing, path, JOINT_NAMES)
    assert path.read_bytes() == whole
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_shown_is_where_the_plan_says(scene, furnished, swing):
    """The shown model agrees with the forward kinematics and the scene.

    Its bodies lie where the forward kinematics put them, its obstacles where the scene does.
    """
    poser = Poser(scene, furnished)
    data = poser.place(swing.q[-1])
    shown = data.body("left_panda_hand_tcp").xpos
    assert np.abs(shown - Kinematics().tcp_poses(swing.q[-1])[0][:3, 3]).max() < 1e-9
    for shape in furnished.obstacles[1:]:
        assert np.abs(data.body(f"shown_{shape.name}").xpos - shape.position_m).max() < 1e-12
    (line,) = tcp_preview(poser.kinematics, swing.q).paths
    assert line.name == "left"  # the right arm stays, so it draws no line
    assert np.abs(line.points[-1] - shown).max() < 1e-9


class Watching:
    """A view that somebody closes after some pictures."""

    def __init__(self, pictures):
        self.left = pictures
        self.seen = []
        self.opened = 0

    @property
    def alive(self):
        return self.left > 0

    def open(self, model):
        self.opened += 1

    def due(self):
        return True

    def update(self, data, overlay):
        self.left -= 1
        self.seen.append((overlay.time_s, data.qpos.copy(), overlay))


def test_a_view_plays_the_plan_and_ends(scene, swing):
    view = Watching(10_000)
    play(view, Poser(scene, PlanningScene()), swing, "a title", rounds_n=1)
    assert view.opened == 1
    times = [t for t, _, _ in view.seen]
    assert times == sorted(times)
    assert times[-1] == swing.duration_s  # it stands at the end for a second
    assert view.seen[-1][2].title == "a title"
    assert len({id(o.preview) for _, _, o in view.seen}) == 1
    ghost = view.seen[0][2].preview.ghosts[0]
    assert np.abs(ghost - view.seen[-1][1]).max() < 1e-12  # it shows where the plan ends
    closed = Watching(5)
    play(closed, Poser(scene, PlanningScene()), swing, "", rounds_n=None)
    assert len(closed.seen) == 5


def test_a_picture_is_drawn(run, tmp_path):
    code, _, _ = run(
        "--scene",
        EXAMPLES / "bench-scene.yaml",
        "--group",
        "left_arm",
        "--from",
        EXAMPLES / "beside-post.yaml",
        "--to",
        "ready",
        "--picture",
        tmp_path / "p.png",
    )
    assert code == 0
    from matplotlib.image import imread

    image = imread(tmp_path / "p.png")
    assert image.shape[0] > 400
    assert image.std() > 0.05  # something is on it
    orange = (image[..., 0] > 1.5 * image[..., 2]) & (image[..., 0] > 0.3)
    assert orange.mean() > 0.002  # the obstacles

"""Parts of the live view that need neither a browser : pace, address, shapes, words, choice."""

import socket
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from minidual.config.scene import SceneConfig
from minidual.errors import UsageError
from minidual.plant.model import build_model
from minidual.show import watch
from minidual.show.planning import plan_words
from minidual.show.view import NAMES, make_view
from minidual.show.view.meshes import HIDDEN_GROUP, body_meshes, moving_bodies
from minidual.show.view.overlay import Overlay
from minidual.show.view.panel import table_html
from minidual.show.view.web import free_port, is_loopback, tunnel_command, url
from minidual.show.watch import visual_model
from tests.support.panda import FINGER_JOINT_NAMES, JOINT_NAMES


class Clock:
    """A clock that moves when told, or when slept on."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def test_the_brake_holds_simulated_time_to_the_clock_and_forgives_lost_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Clock()
    monkeypatch.setattr(watch, "time", SimpleNamespace(monotonic=clock, sleep=clock.sleep))
    brake = watch.Brake(2.0)
    brake.hold(5.0)  # of the run before: simulated time starts anew
    for k in range(101):
        brake.hold(0.01 * k)
    assert clock.now - 100.0 == pytest.approx(0.5)  # one simulated second at twice real time
    clock.sleep(5.0)  # something else took the processor
    brake.hold(1.01)
    before = clock.now
    brake.hold(1.03)
    assert clock.now - before == pytest.approx(0.01)  # no rush to make up for five seconds


def test_a_taken_port_leads_to_the_next_and_a_strange_interface_is_refused() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        found = free_port("127.0.0.1", port)
        assert port < found <= port + 50
        with pytest.raises(UsageError, match=f"no free port for the view among {port} to {port}"):
            free_port("127.0.0.1", port, tries=1)
    with pytest.raises(UsageError, match=r"cannot bind interface '203\.0\.113\.7'"):
        free_port("203.0.113.7", 8080)


def test_addresses_say_who_can_reach_them_and_what_to_type() -> None:
    assert all(is_loopback(host) for host in ("127.0.0.1", "127.3.2.1", "::1", "localhost"))
    assert not any(is_loopback(host) for host in ("0.0.0.0", "::", "192.0.2.1", "example.org"))
    assert url("0.0.0.0", 8081) == "http://127.0.0.1:8081"
    assert url("::1", 80) == "http://[::1]:80"
    assert tunnel_command("127.0.0.1", 8083).startswith("ssh -L 8083:127.0.0.1:8083 ")
    assert tunnel_command("::1", 8083).startswith("ssh -L 8083:[::1]:8083 ")


def test_meshes_are_where_the_model_has_its_geoms() -> None:
    """Oracle: the corners of MuJoCo's own bounding boxes, in the world, at a posture that is not home."""
    model = visual_model(SceneConfig())
    data = mujoco.MjData(model)
    rng = np.random.default_rng(3)
    for name in JOINT_NAMES:
        data.joint(name).qpos[:] = rng.uniform(-0.5, 0.5)
    mujoco.mj_forward(model, data)
    meshes = body_meshes(model)
    assert sum(len(m.faces) for m in meshes) > 10_000
    for body in {m.body for m in meshes}:
        points = np.concatenate([m.vertices for m in meshes if m.body == body]).astype(float)
        geoms = [
            g
            for g in range(model.ngeom)
            if model.geom_bodyid[g] == body
            and model.geom_group[g] < HIDDEN_GROUP
            and model.geom_type[g] != mujoco.mjtGeom.mjGEOM_PLANE
        ]
        boxes = []
        for g in geoms:
            centre = model.geom_aabb[g, :3]
            half = model.geom_aabb[g, 3:]
            corners = centre + half * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, 8).T
            R = np.empty(9)
            mujoco.mju_quat2Mat(R, model.geom_quat[g])
            boxes.append(corners @ R.reshape(3, 3).T + model.geom_pos[g])
        found = np.concatenate(boxes)
        assert (points.min(axis=0) >= found.min(axis=0) - 1e-3).all(), model.body(body).name
        assert (points.max(axis=0) <= found.max(axis=0) + 1e-3).all(), model.body(body).name
        if len(geoms) == 1:  # the box of a turned geom is larger than the geom; its diagonal is not
            assert (
                np.linalg.norm(np.ptp(points, axis=0))
                <= 2.0 * np.linalg.norm(model.geom_aabb[geoms[0], 3:]) * 1.01
            )


def test_collision_shapes_are_not_shown() -> None:
    with_visuals = visual_model(SceneConfig())
    without = build_model(SceneConfig(), visuals=False)
    arms = [b for b in range(without.nbody) if "panda" in without.body(b).name]
    assert not {m.body for m in body_meshes(without)} & set(arms)
    assert {m.body for m in body_meshes(with_visuals)} & set(arms)


def test_the_moving_bodies_are_those_that_move() -> None:
    model = visual_model(SceneConfig())
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    before = np.hstack([data.xpos, data.xquat]).copy()
    for name in (*JOINT_NAMES, *FINGER_JOINT_NAMES):
        data.joint(name).qpos[:] = 0.013
    data.joint("rod_free").qpos[:3] = (0.1, 0.2, 0.3)
    mujoco.mj_kinematics(model, data)
    moved = np.abs(np.hstack([data.xpos, data.xquat]) - before).max(axis=1) > 1e-6
    assert moving_bodies(model) == np.flatnonzero(moved).tolist()


def test_the_model_with_visuals_has_the_bodies_and_joints_of_the_one_without() -> None:
    """The view shows the poses of a model that it was not opened on, by the numbers of their bodies."""
    a = visual_model(SceneConfig())
    b = build_model(SceneConfig(), visuals=False)
    assert [a.body(i).name for i in range(a.nbody)] == [b.body(i).name for i in range(b.nbody)]
    assert np.array_equal(a.jnt_qposadr, b.jnt_qposadr)
    assert a.nq == b.nq


def test_words_are_escaped_and_what_is_not_known_is_not_shown() -> None:
    shown = table_html(
        Overlay(1.25, title="<script>x</script>", mode="policy", source="policy"),
        0.98,
    )
    assert "<script>" not in shown
    assert "&lt;script&gt;" in shown
    assert "0.98 x real time" in shown
    assert "1.25 s" in shown
    assert " N<" not in shown  # forces that nobody measured
    forces = table_html(Overlay(0.0, pinch_n=(12.0, 160.0), internal_n=-0.01), None)
    assert "12.0 N" in forces
    assert "-0.0" not in forces


def test_no_view_costs_nothing_and_unknown_ones_are_named() -> None:
    assert make_view("none") is None
    with pytest.raises(UsageError, match="no view 'webb'; there are none, web") as caught:
        make_view("webb")
    assert caught.value.remedy == "did you mean 'web'?"
    assert NAMES == ("none", "web")


def test_the_panel_says_what_drives_and_what_a_plan_is_worth() -> None:
    shown = table_html(
        Overlay(method="impedance", controller="object impedance", plan="2.10 s of motion, proven"),
        None,
    )
    for words in ("method", "impedance", "controller", "object impedance", "plan", "proven"):
        assert words in shown
    assert "mode" not in shown
    further = table_html(Overlay(lines=(("<b>act", "lift <i>"),)), None)
    assert "&lt;b&gt;act" in further
    assert "lift &lt;i&gt;" in further


@pytest.mark.parametrize(("method", "mode"), [("impedance", ""), ("", "moveit")])
def test_a_trial_is_not_said_to_be_in_the_mode_of_its_source(method: str, mode: str) -> None:
    """The force law of `impedance` uses the source `moveit`; the panel names the method."""
    stack: Any = SimpleNamespace(
        state="active",
        source="moveit",
        reflex=None,
        output=SimpleNamespace(active_source="moveit"),
        manager=SimpleNamespace(active=("object_impedance",)),
        arbiter=SimpleNamespace(underway=SimpleNamespace(executions=())),
    )
    kinematics: Any = None
    shown = watch.StackNarrator(stack, kinematics, "a title", method=method)()
    assert shown.mode == mode
    assert shown.source == (method or "moveit")
    assert shown.controller == "object impedance"


def test_a_plan_is_said_to_be_proven_only_if_it_is() -> None:
    assert plan_words(2.104, True) == "2.10 s of motion, proven free of collisions"
    assert "NOT proven" in plan_words(2.104, False)
    assert plan_words(2.104, None) == "2.10 s of motion"

"""Shapes, scenes and the allowed-collision matrix."""

import hashlib
import itertools
import json

import numpy as np
import pytest

from minidual.collision import acm
from minidual.collision.acm import acm_report, build_acm
from minidual.collision.engines import MujocoEngine
from minidual.collision.scene import TABLE, PlanningScene
from minidual.collision.shapes import Attached, Box, Capsule, Cylinder, Mesh, Pairs, Sphere
from minidual.errors import UsageError
from minidual.robot.description import collision_links, links_of, never_touching
from minidual.robot.models import PANDA
from minidual.robot.pair import DUAL_PANDA

HOME = DUAL_PANDA.home
Q_LOWER = DUAL_PANDA.q_lower
Q_UPPER = DUAL_PANDA.q_upper
LINKS = collision_links(DUAL_PANDA)


def side_of(name):
    return links_of(DUAL_PANDA)[name].side


def test_links_are_those_of_the_model():
    engine = MujocoEngine(PlanningScene(obstacles=()))
    model = engine.model
    with_geometry = {model.body(int(b)).name for b in model.geom_bodyid}
    assert with_geometry == set(LINKS)


def test_joints_before_counts_the_joints_that_move_a_link():
    links = links_of(DUAL_PANDA)
    assert links["left_panda_link0"].joints_before == 0
    assert links["right_panda_link5"].joints_before == 5
    assert (
        links["right_panda_hand"].joints_before == links["left_panda_leftfinger"].joints_before == 7
    )
    assert (links["left_panda_hand_tcp"].side, links["left_panda_hand_tcp"].collides) == (
        "left",
        False,
    )
    assert "left_table" not in links


FLAT = np.array([[0, 0, 0], [0.1, 0, 0.05], [0, 0.1, 0.05], [0.1, 0.1, 0.1]], dtype=float)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Box("b", (0, 0, 0), size_m=(0.1, -0.1, 0.1)), "length -0.1"),
        (lambda: Sphere("s", (0, float("nan"), 0), radius_m=0.1), "not finite"),
        (lambda: Cylinder("c", (0, 0, 0), (1.0, 0.5, 0.0, 0.0)), "not of length 1"),
        (lambda: Capsule("", (0, 0, 0)), "needs a name"),
        (lambda: Box("grain", (0, 0, 0), size_m=(0.1, 0.1, 1e-5)), "must be 0.0001 or more"),
        (lambda: Mesh("m", (0, 0, 0), pieces=(FLAT.tobytes(),)), "no solid"),
        (
            lambda: Mesh("m", (0, 0, 0), pieces=(np.outer(range(4), [0.1, 0.2, 0.3]).tobytes(),)),
            "no solid",
        ),
    ],
)
def test_bad_shapes_are_refused(make, says):
    with pytest.raises(UsageError, match=says):
        make()


def test_a_quaternion_a_little_off_unit_length_turns_and_does_not_shrink():
    """A wall of 1 km is as near to the collision libraries as to the proof."""
    R = Box("w", (0, 0, 0), (0.7071065, 0.0, 0.0, 0.7071065)).T_parent_shape[:3, :3]
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-15)


def test_two_things_of_one_name_are_refused():
    with pytest.raises(UsageError, match="'table' twice"):
        PlanningScene().with_obstacles(Sphere("table", (1, 0, 0)))
    with pytest.raises(UsageError, match="'left_panda_hand' twice"):
        PlanningScene().with_obstacles(Sphere("left_panda_hand", (1, 0, 0)))


def test_unknown_names_are_told_with_what_exists():
    with pytest.raises(UsageError, match="no link or obstacle 'box'"):
        PlanningScene().allowing("box", "table")
    with pytest.raises(UsageError, match="no link 'left_hand'"):
        PlanningScene().with_attached(Attached(Sphere("ball", (0, 0, 0)), "left_hand"))


def test_cross_arm_pairs_are_always_checked():
    scene = PlanningScene()
    crossing = [p for p in itertools.combinations(LINKS, 2) if side_of(p[0]) != side_of(p[1])]
    unchecked = {p for p in crossing if scene.why_unchecked(*p) is not None}
    assert unchecked == {("left_panda_link0", "right_panda_link0")}  # neither base moves
    assert len(crossing) == 121


def test_every_allowed_pair_has_a_reason_and_stays_within_one_arm():
    for first, second, reason in sorted(acm_report(DUAL_PANDA).acm):
        assert side_of(first) == side_of(second)
        assert reason.split(" ")[0] in ("rigid", "adjacent", "always", "never")


def test_both_arms_have_the_same_matrix():
    table = sorted(acm_report(DUAL_PANDA).acm)
    left = {(a[5:], b[5:], r) for a, b, r in table if a.startswith("left_")}
    right = {(a[6:], b[6:], r) for a, b, r in table if a.startswith("right_")}
    assert left == right


def test_the_pairs_of_the_published_srdf_that_may_touch_cover_ours_that_always_do():
    """Oracle: what we call adjacent or rigid must be disabled in the Panda's own SRDF too."""
    published = {frozenset(p) for p in never_touching(PANDA)}
    ours = {
        frozenset((a[5:], b[5:]))
        for a, b, r in sorted(acm_report(DUAL_PANDA).acm)
        if a.startswith("left_") and r in ("adjacent", "rigid")
    }
    fingers = frozenset(("panda_leftfinger", "panda_rightfinger"))
    link7 = {frozenset(("panda_link7", f)) for f in fingers}
    assert ours - {fingers} - link7 <= published


def test_few_samples_would_drop_pairs_that_collide():
    """Why the default takes tens of thousands: a thousand samples call pairs `never` that do touch."""
    few = build_acm(DUAL_PANDA, samples_min=500, samples_max=1000).acm
    never_few = {(a, b) for a, b, r in few if r.startswith("never")}
    never = {(a, b) for a, b, r in sorted(acm_report(DUAL_PANDA).acm) if r.startswith("never")}
    assert never <= never_few
    assert len(never_few) > len(never)


def test_what_is_called_never_does_not_touch_in_fresh_samples():
    matrix = acm_report(DUAL_PANDA).acm
    never = [
        (a, b) for a, b, r in sorted(matrix) if r.startswith("never") and a.startswith("left_")
    ]
    engine = MujocoEngine(Pairs(DUAL_PANDA, tuple(never)))
    rng = np.random.default_rng(99)
    Q = np.tile(HOME, (20_000, 1))
    Q[:, :7] = rng.uniform(Q_LOWER[:7], Q_UPPER[:7], (len(Q), 7))
    assert not engine.collisions(Q).any()


def test_cache_is_used_refreshed_and_never_needed(tmp_path, monkeypatch):
    monkeypatch.setenv("MINIDUAL_CACHE", str(tmp_path))
    built = []
    matrix = acm_report(DUAL_PANDA)
    monkeypatch.setattr(acm, "build_acm", lambda _: built.append(1) or matrix)
    fresh = acm_report.__wrapped__
    assert fresh(DUAL_PANDA) == matrix
    (file,) = tmp_path.glob("acm-*.json")
    assert fresh(DUAL_PANDA) == matrix
    assert len(built) == 1  # the second call read the file
    whole = file.read_text()
    digest, content = whole.split("\n")
    pairs = [["left_panda_hand", "left_panda_link5", "never"], *matrix.pairs]
    tampered = f"{digest}\n{json.dumps(json.loads(content) | {'pairs': pairs})}"
    of_another_model = f"{hashlib.sha256(f'another\n{content}'.encode()).hexdigest()}\n{content}"
    for bad in ("", content, tampered, of_another_model, whole[:-1]):
        file.write_text(bad)
        assert fresh(DUAL_PANDA) == matrix
        assert file.read_text() == whole
    assert len(built) == 6  # each was built anew
    monkeypatch.setenv("MINIDUAL_CACHE", "/proc/nowhere")
    assert fresh(DUAL_PANDA) == matrix


def test_adding_and_removing_a_pair():
    scene = PlanningScene(allowed=frozenset())
    (b, a) = ("table", "left_panda_hand")
    more = scene.allowing(b, a, "because")
    assert more.why_unchecked(a, b) == more.why_unchecked(b, a) == "because"
    assert sorted(more.allowing(a, b, "again").allowed) == [(a, b, "again")]
    assert more.forbidding(b, a) == scene
    with pytest.raises(UsageError, match="checked already"):
        scene.forbidding(a, b)
    with pytest.raises(UsageError, match="itself"):
        scene.allowing(a, a)


def test_attached_object_moves_with_its_hand_and_may_touch_its_fingers():
    fingers = ("left_panda_leftfinger", "left_panda_rightfinger")
    scene = PlanningScene().with_attached(
        Attached(Sphere("ball", (0, 0, 0.1), radius_m=0.03), "left_panda_hand", fingers),
    )
    assert scene.why_unchecked("ball", "left_panda_hand") == "rigid"
    assert scene.why_unchecked("ball", "left_panda_leftfinger") == "rigid"
    assert scene.why_unchecked("ball", "right_panda_hand") is None
    assert scene.why_unchecked("ball", "table") is None
    assert MujocoEngine(scene).touching_pairs(HOME) == set()


def test_scene_is_a_key():
    a = PlanningScene().with_obstacles(Sphere("s", (1.0, 0.0, 0.5)))
    b = PlanningScene(obstacles=(TABLE, Sphere("s", (1.0, 0.0, 0.5))))
    assert a == b
    assert hash(a) == hash(b)
    assert a != PlanningScene()

"""A toy of the rod task for the learning tests: the real image scale and ranges, no physics, fast to render.

Two hands reach for a bar 2.3 pixels wide and 39 long whose pose varies by 5 cm and 15 degrees, seen by one 96x128
camera at 7.7 mm a pixel, with white arms that move with the joints and cover part of the view. Joints are a mildly
nonlinear function of the hand poses, so the hand poses that a policy commands can be decoded exactly, and the
error of the grasp is measured in closed loop, in millimetres.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from minidual.policies.demonstrations import Demonstrations

HEIGHT = 96
WIDTH = 128
M_PER_PX = 0.0077
APPROACH = 150
CLOSING = 25
CARRY = 45
HALF_GRASP_M = 0.12
HALF_ROD_M = 0.15
RADIUS_M = 0.00887
HOME = np.array(
    [[-0.05, 0.25, 0.25, 0.0], [-0.05, -0.25, 0.25, 0.0]],
)  # left, right: x, y, z [m], yaw [rad]
_V, _U = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)


def _joint_map() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rng = np.random.default_rng(7)
    return rng.normal(0, 1.0, (2, 7, 4)), rng.normal(0, 0.8, (2, 7))


_M, _Q0 = _joint_map()


def joints(hands: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (14,) joints of hand poses (2, 4)."""
    return np.concatenate([_Q0[a] + _M[a] @ (np.sinh(3 * hands[a]) / 3) for a in range(2)])


def hands_of(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the hand poses (2, 4) of (14,) joints: least squares, exact for reachable joints."""
    stacked = [
        np.linalg.lstsq(_M[a], q[7 * a : 7 * a + 7] - _Q0[a], rcond=None)[0] for a in range(2)
    ]
    return np.arcsinh(3 * np.array(stacked)) / 3


def _pixel(x: float, y: float) -> tuple[float, float]:
    return 48.0 + x / M_PER_PX, 64.0 - y / M_PER_PX  # row, column; +y is to the left


def _cover(a: tuple[float, float], b: tuple[float, float], radius_px: float) -> NDArray[np.float32]:
    """Return the antialiased coverage (H, W) of a capsule from a to b, both (row, column)."""
    d = np.array(b) - np.array(a)
    length = float(d @ d) + 1e-9
    t = np.clip(((_V - a[0]) * d[0] + (_U - a[1]) * d[1]) / length, 0, 1)
    distance = np.hypot(_V - a[0] - t * d[0], _U - a[1] - t * d[1])
    return np.clip(radius_px + 0.5 - distance, 0, 1).astype(np.float32)


_BACKGROUND = (
    np.array([120, 110, 100], np.float32)
    + 12 * np.sin(_V / 9.0)[..., None]
    + 10 * np.cos(_U / 13.0)[..., None]
)


def render(
    rod: NDArray[np.float64],
    hands: NDArray[np.float64],
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Return a (96, 128, 3) image of the bar (x, y [m], yaw [rad]) and the two arms over it."""
    image = _BACKGROUND.copy()
    along = HALF_ROD_M * np.array([-np.sin(rod[2]), np.cos(rod[2])])
    layers = [
        (
            _cover(_pixel(*(rod[:2] - along)), _pixel(*(rod[:2] + along)), RADIUS_M / M_PER_PX),
            (200.0, 40, 30),
        ),
    ]
    for hand, base in zip(hands, ((-0.5, 0.25), (-0.5, -0.25)), strict=True):
        x = hand[0] - 0.3 * hand[2]  # a raised hand appears further up
        y = hand[1]
        layers.append((_cover(_pixel(*base), _pixel(x - 0.06, y), 4.0), (235.0, 235, 230)))
        layers.append((_cover(_pixel(x - 0.06, y), _pixel(x, y), 2.5), (60.0, 60, 65)))
    for cover, colour in layers:
        image += cover[..., None] * (np.array(colour, np.float32) - image)
    image += rng.standard_normal(image.shape, dtype=np.float32) * 2.0
    return np.clip(image, 0, 255).astype(np.uint8)


def sample_rod(rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a start pose: +-5 cm, +-15 degrees."""
    return rng.uniform(-1, 1, 3) * np.array([0.05, 0.05, np.radians(15)])


def grasp_of(rod: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the hand poses (2, 4) that grasp the bar 12 cm either side of its centre."""
    along = HALF_GRASP_M * np.array([-np.sin(rod[2]), np.cos(rod[2])])
    return np.array([[*(rod[:2] + s * along), 0.0, rod[2]] for s in (1, -1)])


def _smooth(n: int) -> NDArray[np.float64]:
    t = (np.arange(n) + 1) / n
    return t**3 * (10 - 15 * t + 6 * t * t)


def expert(rod: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the commanded hand poses (T, 2, 4) and openings (T, 2), 1 open and 0 closed."""
    grasp = grasp_of(rod)
    goal = grasp_of(np.array([0.0, -0.2, 0.0])) + np.array([0, 0, 0.1, 0])
    approach = HOME + _smooth(APPROACH)[:, None, None] * (grasp - HOME)
    carry = grasp + _smooth(CARRY)[:, None, None] * (goal - grasp)
    poses = np.concatenate([approach, np.repeat(grasp[None], CLOSING, axis=0), carry])
    opening = np.ones((len(poses), 2))
    opening[APPROACH:] = 0.0
    return poses, opening


def demonstrations(episodes: int, seed: int, every: int = 1) -> Demonstrations:
    """Return recorded episodes of the expert; `every` > 1 keeps every n-th tick to make tests smaller."""
    rng = np.random.default_rng(seed)
    images = []
    states = []
    actions = []
    index = []
    for episode in range(episodes):
        rod = sample_rod(rng)
        poses, opening = expert(rod)
        command = np.array([joints(p) for p in poses])
        grasp_centre = rod
        for t in range(0, len(poses), every):
            before = max(t - 1, 0)
            now = poses[before] if t else HOME
            held = grasp_centre.copy()
            if t > APPROACH:  # the bar moves with the hands
                held[:2] += (now - grasp_of(rod)).mean(axis=0)[:2]
            images.append(render(held, now, rng))
            states.append(np.concatenate([command[before] if t else joints(HOME), opening[before]]))
            actions.append(np.concatenate([command[t], opening[t]]))
            index.append(episode)
    return Demonstrations(
        {"high": np.array(images)},
        np.array(states, np.float32),
        np.array(actions, np.float32),
        np.array(index, np.int64),
    )


@dataclass
class GraspErrors:
    """Closed-loop errors over episodes, (E,): along the bar's travel (y), across (x) [mm], and yaw [deg]."""

    x_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]
    yaw_deg: NDArray[np.float64]
    closed: NDArray[np.bool_]


def closed_loop(act, reset, episodes: int, seed: int) -> GraspErrors:  # type: ignore[no-untyped-def]
    """Let `act(images, state) -> (16,)` drive the hands from home until it closes; return the grasp errors."""
    rng = np.random.default_rng(seed)
    errors = []
    closed = []
    for _ in range(episodes):
        rod = sample_rod(rng)
        reset()
        q = joints(HOME)
        opening = np.ones(2)
        for _tick in range(APPROACH + 60):
            hands = hands_of(q)
            look = functools.partial(render, rod, hands, rng)
            action = act({"high": look}, np.concatenate([q, opening]))
            if action[14:].min() < 0.4:
                break
            q = q + 0.5 * (action[:14] - q)  # a servo that lags
            opening = action[14:]
        hands = hands_of(q)
        centre = hands.mean(axis=0)
        d = hands[0, :2] - hands[1, :2]
        yaw = np.arctan2(-d[0], d[1])
        errors.append(
            [(centre[0] - rod[0]) * 1e3, (centre[1] - rod[1]) * 1e3, np.degrees(yaw - rod[2])],
        )
        closed.append(action[14:].min() < 0.4)
    table = np.array(errors)
    return GraspErrors(table[:, 0], table[:, 1], table[:, 2], np.array(closed))

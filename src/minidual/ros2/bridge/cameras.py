"""Draw and publish the cameras in a process of their own, so that drawing delays no joint state."""

import contextlib
import multiprocessing
import signal
import time
from collections.abc import Sequence
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import mujoco
import numpy as np

from minidual.config.scene import SceneConfig
from minidual.plant.model import build_model
from minidual.plant.render import Camera
from minidual.robot.pair import Array, Robot
from minidual.ros2.bags.episode_topics import ENCODING
from minidual.ros2.bridge.topics import Topics, now_stamp
from minidual.ros2.names import image_topic

CAMERA_HZ = 30.0
_END_S = 5.0
"""Longest wait for the process to end by itself."""


class _State(NamedTuple):
    """A state to draw: MuJoCo's positions, and the time of their measurement (seconds, nanoseconds)."""

    qpos: Array
    stamp: tuple[int, int]


class _Scene(NamedTuple):
    """Inputs of the drawing process.

    Attributes:
        scene: The world.
        robot: The pair of arms.
        cameras: Names, drawn in turn.
        domain: DDS domain of the pictures.
    """

    scene: SceneConfig
    robot: Robot
    cameras: tuple[str, ...]
    domain: int


class CameraProcess:
    """Publishes pictures of the states that it is offered.

    It asks for a state when it is ready to draw; one that comes too early is dropped.

    Attributes:
        pictures_n: {camera: pictures published}.
    """

    def __init__(
        self,
        scene: SceneConfig,
        robot: Robot,
        cameras: Sequence[str],
        domain: int,
    ) -> None:
        context = multiprocessing.get_context("spawn")  # OpenGL does not survive a fork
        self._connection, theirs = context.Pipe()
        inputs = _Scene(scene, robot, tuple(cameras), domain)
        self._process = context.Process(target=_draw, args=(theirs, inputs), daemon=True)
        self._process.start()
        theirs.close()
        self.pictures_n = dict.fromkeys(cameras, 0)
        self._first_s = time.monotonic()
        self._last_s = self._first_s

    @property
    def alive(self) -> bool:
        """Whether it still draws."""
        return self._process.is_alive()

    def offer(self, qpos: Array) -> None:
        """Send the positions (nq,) of the world if they are asked for; never wait."""
        with contextlib.suppress(EOFError, OSError):  # the process has ended
            if self._connection.poll():
                camera = self._connection.recv()
                self._last_s = time.monotonic()
                if camera is None:  # it has just begun
                    self._first_s = self._last_s
                else:
                    self.pictures_n[camera] += 1
                self._connection.send(_State(np.array(qpos), now_stamp()))

    def rates_hz(self) -> dict[str, float]:
        """Return the pictures a second of each camera, since the process began to draw."""
        span_s = self._last_s - self._first_s
        return {
            camera: pictures_n / span_s if span_s > 0.0 else 0.0
            for camera, pictures_n in self.pictures_n.items()
        }

    def close(self) -> None:
        """End the process."""
        with contextlib.suppress(EOFError, OSError):
            self._connection.send(None)
            self._connection.close()
        self._process.join(_END_S)
        if self._process.is_alive():
            self._process.terminate()


def _draw(connection: Connection, inputs: _Scene) -> None:
    """Draw and publish until None comes: the body of the process.

    It asks by sending the camera whose picture it published last.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes of a terminal
    topics = Topics(inputs.domain)
    for camera in inputs.cameras:
        topics.advertise(image_topic(camera), topics.messages.Image)
    model = build_model(inputs.scene, inputs.robot, visuals=True)
    data = mujoco.MjData(model)
    period_s = 1.0 / (CAMERA_HZ * len(inputs.cameras))
    published: str | None = None
    due_s = time.monotonic()
    with (
        Camera.recorded(model, inputs.scene.camera) as eyes,
        contextlib.suppress(EOFError, OSError),
    ):
        turn = 0
        while True:
            connection.send(published)
            state = connection.recv()
            if state is None:
                break
            camera = inputs.cameras[turn % len(inputs.cameras)]
            turn += 1
            data.qpos[:] = state.qpos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            topics.publish(image_topic(camera), _message(topics, camera, state, eyes, data))
            published = camera
            due_s = max(due_s + period_s, time.monotonic())
            time.sleep(max(0.0, due_s - time.monotonic()))
    topics.close()


def _message(
    topics: Topics,
    camera: str,
    state: _State,
    eyes: Camera,
    data: mujoco.MjData,
) -> Any:
    """Return the picture of a camera, stamped with the time of its state."""
    m = topics.messages
    pixels = eyes.picture(data, camera)
    height, width, channels = pixels.shape
    header = m.Header(m.Time(*state.stamp), f"camera_{camera}_optical_frame")
    return m.Image(header, height, width, ENCODING, 0, width * channels, pixels.tobytes())

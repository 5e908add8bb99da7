"""The camera of films."""

from collections.abc import Sequence
from contextlib import AbstractContextManager

import mujoco
import numpy as np
import numpy.typing as npt

from minidual.plant.render import Camera, Image
from minidual.robot.pair import Array
from minidual.show.figures.film_model import CAMERA
from minidual.show.view.overlay import ARROW_M_PER_N, Arrow

_M_PER_N = 2.0 * ARROW_M_PER_N
"""Films are smaller than the view: 40 N are 20 cm."""
_ARROW_MIN_N = 1.0
_ARROW_RADIUS_M = 0.011
_GLOW = 0.5
"""Arrows are bright in the shade, too."""


class FilmCamera(AbstractContextManager["FilmCamera"]):
    """Draws postures of a film's model; close it after use.

    Args:
        model: Of `film_model`.
        size_px: Width and height.
        shadows: Whether lamps cast them; a picture without takes a third of the time.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        size_px: tuple[int, int],
        *,
        shadows: bool = True,
    ) -> None:
        self._model = model
        self._data = mujoco.MjData(model)
        self._camera = Camera(model, *size_px, shadows=shadows)

    def picture(
        self,
        qpos: Array,
        arrows: Sequence[Arrow] = (),
        camera: str = CAMERA,
    ) -> Image:
        """Return the image (H, W, 3) of a posture (nq,) with forces."""
        self._pose(qpos)

        def decorate(scene: mujoco.MjvScene) -> None:
            for arrow in arrows:
                add_arrow(scene, arrow)

        return self._camera.picture(self._data, camera, decorate)

    def close_up(self, qpos: Array, at: npt.ArrayLike) -> Image:
        """Return the image (H, W, 3) of a camera 0.9 m in front of a place (3,) [m]."""
        self._pose(qpos)
        return self._camera.close_up(self._data, at)

    def _pose(self, qpos: Array) -> None:
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)

    def __exit__(self, *error: object) -> None:
        self._camera.close()


def add_arrow(scene: mujoco.MjvScene, arrow: Arrow) -> None:
    """Add a force, its tip at the hand, to what is drawn, unless it is tiny or there is no room."""
    is_tiny = float(np.linalg.norm(arrow.force)) < _ARROW_MIN_N
    if is_tiny or scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    rgba = np.array([*(channel / 255.0 for channel in arrow.rgb), 1.0], dtype=np.float32)
    mujoco.mjv_initGeom(
        geom,
        mujoco.mjtGeom.mjGEOM_ARROW,
        np.zeros(3),
        np.zeros(3),
        np.zeros(9),
        rgba,
    )
    mujoco.mjv_connector(
        geom,
        mujoco.mjtGeom.mjGEOM_ARROW,
        _ARROW_RADIUS_M,
        arrow.start - _M_PER_N * arrow.force,
        arrow.start,
    )
    geom.size[2] *= 2.0  # MuJoCo draws arrows half as long as connectors
    geom.emission = _GLOW
    scene.ngeom += 1

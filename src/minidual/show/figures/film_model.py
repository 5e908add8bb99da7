"""The model of films: the scene as it is simulated, in a better light.

Policies and recordings see the plain model: this one is only looked at. It has finer meshes, a
wooden table, a tiled floor, two lights and four samples a pixel.
"""

import functools

import mujoco
import numpy as np
import numpy.typing as npt

from minidual.config.scene import SceneConfig
from minidual.config.seeds import stream
from minidual.plant.cameras import add_camera
from minidual.plant.model import build_spec
from minidual.robot.pair import DUAL_PANDA, Robot

CAMERA = "film"
FACES_PER_ARM = 18_000
"""Triangles of an arm: twice those of a camera's picture. More take longer to draw in software."""
_CAMERA_AT_M = (1.72, -0.95, 0.98)
_CAMERA_TARGET_M = (0.30, 0.0, 0.22)
_CAMERA_FOVY_DEG = 38.0
_TEXTURE_PX = 512
_PLANKS = 6
_WOOD_RGB = (0.66, 0.53, 0.40)
_SEAM_SHARE = 0.02
"""Width of the gap between planks."""
_RGB = mujoco.mjtTextureRole.mjTEXROLE_RGB


@functools.lru_cache(maxsize=2)
def film_model(scene: SceneConfig, robot: Robot = DUAL_PANDA) -> mujoco.MjModel:
    """Compile the model; positions (nq,) and geoms are in the order of the simulated one."""
    spec = build_spec(scene, robot, visuals=True, faces_per_arm=FACES_PER_ARM)
    _set_quality(spec)
    _set_lights(spec)
    _set_table(spec)
    _set_floor(spec)
    add_camera(spec, CAMERA, _CAMERA_AT_M, _CAMERA_TARGET_M, _CAMERA_FOVY_DEG)
    return spec.compile()


def _set_quality(spec: mujoco.MjSpec) -> None:
    spec.visual.quality.offsamples = 4


def _set_lights(spec: mujoco.MjSpec) -> None:
    """Let a warm light cast the shadows, and a cool one fill them."""
    headlight = spec.visual.headlight
    headlight.ambient = [0.28, 0.28, 0.29]
    headlight.diffuse = [0.22, 0.22, 0.22]
    headlight.specular = [0.05, 0.05, 0.05]
    key = spec.light("key")
    key.pos = [1.2, 1.4, 2.4]
    key.dir = [-0.45, -0.55, -1.0]
    key.diffuse = [0.62, 0.60, 0.56]
    spec.worldbody.add_light(
        name="fill",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[1.0, -1.5, 1.6],
        dir=[-0.5, 0.8, -0.7],
        castshadow=False,
        diffuse=[0.20, 0.21, 0.24],
        specular=[0.05, 0.05, 0.05],
    )


def _set_table(spec: mujoco.MjSpec) -> None:
    texture = spec.add_texture(
        name="wood",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=_TEXTURE_PX,
        height=_TEXTURE_PX,
        nchannel=3,
    )
    texture.data = wood(_TEXTURE_PX).tobytes()
    _cover(spec, "table_top", "wood", repeat=(1.2, 1.6), reflectance=0.03)


def _set_floor(spec: mujoco.MjSpec) -> None:
    spec.add_texture(
        name="tiles",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.84, 0.85, 0.86],
        rgb2=[0.82, 0.83, 0.845],
        mark=mujoco.mjtMark.mjMARK_EDGE,
        markrgb=[0.74, 0.75, 0.77],
        width=300,
        height=300,
    )
    _cover(spec, "floor", "tiles", repeat=(1.2, 1.2), reflectance=0.06)


def _cover(
    spec: mujoco.MjSpec,
    geom_name: str,
    texture: str,
    *,
    repeat: tuple[float, float],
    reflectance: float,
) -> None:
    """Give a geom a texture, `repeat` times a metre."""
    material = spec.add_material(name=texture)
    material.textures[_RGB] = texture
    material.texrepeat = list(repeat)
    material.texuniform = True
    material.reflectance = reflectance
    geom = spec.geom(geom_name)
    geom.material = texture
    geom.rgba = [1.0, 1.0, 1.0, 1.0]


def wood(size_px: int) -> npt.NDArray[np.uint8]:
    """Return a picture (size, size, 3) of planks, the same each time."""
    rng = stream(0, "wood")
    x = np.linspace(0.0, 1.0, size_px, endpoint=False)[None, :]
    y = np.linspace(0.0, 1.0, size_px, endpoint=False)[:, None]
    plank = np.floor(y * _PLANKS).astype(int)
    across = y * _PLANKS - plank
    tone = rng.uniform(-0.05, 0.05, _PLANKS)[plank]
    phase = rng.uniform(0.0, 10.0, _PLANKS)[plank]
    turn = 2.0 * np.pi
    bend = 0.03 * np.sin(turn * (1.3 * x + phase)) + 0.012 * np.sin(turn * (4.1 * x + 2.0 * phase))
    coarse = np.sin(turn * 9.0 * (across + 3.0 * bend + phase))
    fine = np.sin(turn * 31.0 * (across + 2.0 * bend + phase))
    noise = rng.normal(0.0, 0.012, (size_px, size_px))
    brightness = 1.0 + tone + 0.025 * coarse + 0.015 * fine + noise
    at_a_seam = (across < _SEAM_SHARE) | (across > 1.0 - _SEAM_SHARE)
    brightness = np.where(at_a_seam, 0.78 * brightness, brightness)
    colours = np.clip(np.multiply.outer(brightness, _WOOD_RGB), 0.0, 1.0)
    return (255.0 * colours).astype(np.uint8)


def paint_as(model: mujoco.MjModel, simulated: mujoco.MjModel) -> None:
    """Give the model of a film the colours and sizes that a condition gave the simulated one."""
    textured = model.geom_matid >= 0
    model.geom_rgba[~textured] = simulated.geom_rgba[~textured]
    for name in ("geom_size", "geom_pos", "geom_quat"):
        same_shape = model.geom_type != int(mujoco.mjtGeom.mjGEOM_MESH)
        getattr(model, name)[same_shape] = getattr(simulated, name)[same_shape]

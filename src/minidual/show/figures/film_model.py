"""The model of films: the scene as it is simulated, in a better light.

Policies and recordings see the plain model: this one is only looked at. It has finer meshes, a
wooden table, two lights, four samples a pixel, and objects that look like what they are.
"""

import functools
from copy import copy

import mujoco
import numpy as np

from minidual.config.scene import SceneConfig
from minidual.plant.cameras import facing
from minidual.plant.contact import GROUP_COLLISION, GROUP_MARKER, GROUP_VISUAL, INTANGIBLE
from minidual.plant.model import build_spec
from minidual.plant.surroundings import TABLE_RGBA
from minidual.robot.pair import DUAL_PANDA, Robot
from minidual.show.figures.film_objects import PREFIX, dress, look_of
from minidual.show.figures.film_shapes import arm_shells, rounded_box
from minidual.show.figures.film_textures import wood

CAMERA = "overview"
"""Stands closer than in the simulated model."""
_CAMERA_AT_M = (1.80, -0.52, 1.02)
_CAMERA_TARGET_M = (0.28, -0.005, 0.25)
_CAMERA_FOVY_DEG = 37.0
_TEXTURE_PX = 1024
_SHADOW_PX = 4096
_SHADOW_REACH = 2.4
_EXTENT_M = 1.9
_HORIZON_RGB = (0.86, 0.88, 0.91)
_PLATE_HALF_M = (0.13, 0.12, 0.004)
_PLATE_X_M = -0.04
_TEXTURED = ("table_top", "floor")
_KEY_DIFFUSE = "simulated_key_diffuse"
"""Number in the model: how bright the simulated lamp is."""
_RGB = mujoco.mjtTextureRole.mjTEXROLE_RGB


def film_model(
    scene: SceneConfig,
    robot: Robot = DUAL_PANDA,
    *,
    fine: bool = False,
) -> mujoco.MjModel:
    """Return the model; positions (nq,) are those of the simulated one.

    Args:
        scene: As simulated.
        robot: As simulated.
        fine: Draw all triangles of the arms' files: for single pictures, at twice the time.
    """
    return _compiled(scene, robot, fine)  # type: ignore[arg-type]  # frozen, so hashable


@functools.lru_cache(maxsize=2)
def _compiled(scene: SceneConfig, robot: Robot, fine: bool) -> mujoco.MjModel:
    spec = build_spec(scene, robot, visuals=False)
    _set_quality(spec)
    _set_lights(spec)
    _set_table(spec)
    _set_floor(spec)
    _add_arms(spec, robot, fine=fine)
    dress(spec, scene)
    _hide_fiducials(spec)
    _move_camera(spec)
    return spec.compile()


def _set_quality(spec: mujoco.MjSpec) -> None:
    spec.visual.quality.offsamples = 4
    spec.visual.quality.shadowsize = _SHADOW_PX
    spec.visual.map.shadowclip = _SHADOW_REACH
    spec.stat.extent = _EXTENT_M


def _set_lights(spec: mujoco.MjSpec) -> None:
    """Add a warm light that casts shadows, and a cool fill light."""
    headlight = spec.visual.headlight
    headlight.ambient = [0.33, 0.33, 0.34]
    headlight.diffuse = [0.16, 0.16, 0.16]
    headlight.specular = [0.05, 0.05, 0.05]
    key = spec.light("key")
    spec.add_numeric(name=_KEY_DIFFUSE, size=1, data=[float(key.diffuse[0])])
    key.pos = [1.2, 1.4, 2.4]
    key.dir = [-0.42, -0.50, -1.0]
    key.diffuse = [0.52, 0.50, 0.47]
    key.specular = [0.35, 0.35, 0.33]
    spec.worldbody.add_light(
        name="fill",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[1.0, -1.5, 1.6],
        dir=[-0.5, 0.8, -0.7],
        castshadow=False,
        diffuse=[0.16, 0.17, 0.19],
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
    _cover(spec, "table_top", "wood", repeat=(1.0, 1.0))


def _set_floor(spec: mujoco.MjSpec) -> None:
    """Add an endless floor that fades into the sky."""
    red, green, blue = _HORIZON_RGB
    spec.visual.rgba.haze = [red, green, blue, 1.0]
    sky = spec.texture("sky")
    sky.rgb1 = [0.96, 0.97, 0.98]
    sky.rgb2 = list(_HORIZON_RGB)
    spec.add_texture(
        name="tiles",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.90, 0.91, 0.92],
        rgb2=[0.88, 0.89, 0.905],
        mark=mujoco.mjtMark.mjMARK_EDGE,
        markrgb=[0.80, 0.81, 0.83],
        width=300,
        height=300,
    )
    _cover(spec, "floor", "tiles", repeat=(1.0, 1.0))
    spec.geom("floor").size = [0.0, 0.0, 0.05]


def _cover(
    spec: mujoco.MjSpec,
    geom_name: str,
    texture: str,
    *,
    repeat: tuple[float, float],
) -> None:
    """Give a geom a texture, `repeat` times a metre."""
    material = spec.add_material(name=texture)
    material.textures[_RGB] = texture
    material.texrepeat = list(repeat)
    material.texuniform = True
    material.specular = 0.1
    geom = spec.geom(geom_name)
    geom.material = texture
    geom.rgba = [1.0, 1.0, 1.0, 1.0]


def _add_arms(spec: mujoco.MjSpec, robot: Robot, *, fine: bool) -> None:
    """Add the arms' shells, and a plate under each."""
    spec.add_material(name="shell", specular=0.35, shininess=0.5)
    vertices, faces, normals = rounded_box(_PLATE_HALF_M, 0.003)
    spec.add_mesh(
        name="plate",
        uservert=vertices.ravel(),
        userface=faces.ravel(),
        usernormal=normals.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    shells = [
        (sides, prefix, index, visual)
        for sides, prefix, arm in robot.distinct_arms()
        for index, visual in enumerate(arm_shells(arm, fine=fine))
    ]
    for sides, prefix, index, visual in shells:
        name = f"{prefix}shell{index}_{visual.link}"
        spec.add_mesh(
            name=name,
            uservert=visual.vertices.ravel(),
            userface=visual.faces.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        for side in sides:
            _add_mesh_geom(spec.body(f"{side}_{visual.link}"), f"{side}_{name}", name, visual.rgba)
    for side, base_link in zip(robot.sides, robot.base_links, strict=True):
        base = spec.body(base_link)
        plate = _add_mesh_geom(base, f"{side}_plate", "plate", (0.20, 0.21, 0.23, 1.0))
        plate.pos = [_PLATE_X_M, 0.0, _PLATE_HALF_M[2]]


def _add_mesh_geom(
    body: mujoco.MjsBody,
    name: str,
    mesh: str,
    rgba: tuple[float, ...],
) -> mujoco.MjsGeom:
    return body.add_geom(
        name=f"{PREFIX}{name}",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=mesh,
        material="shell",
        rgba=rgba,
        group=GROUP_VISUAL,
        density=0.0,
        **INTANGIBLE,
    )


def _hide_fiducials(spec: mujoco.MjSpec) -> None:
    """Hide the marks without a name: they tell cameras where they stand."""
    for geom in spec.worldbody.geoms:
        if geom.group == GROUP_MARKER and not geom.name:
            geom.group = GROUP_COLLISION


def _move_camera(spec: mujoco.MjSpec) -> None:
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, facing(_CAMERA_AT_M, _CAMERA_TARGET_M).ravel())
    camera = spec.camera(CAMERA)
    camera.pos = list(_CAMERA_AT_M)
    camera.quat = quat.tolist()
    camera.fovy = _CAMERA_FOVY_DEG


def painted(
    scene: SceneConfig,
    robot: Robot,
    simulated: mujoco.MjModel,
    *,
    fine: bool = False,
) -> mujoco.MjModel:
    """Return a model of a film that shows a simulated model as a condition has changed it."""
    model = copy(film_model(scene, robot, fine=fine))
    paint_as(model, simulated)
    return model


def paint_as(model: mujoco.MjModel, simulated: mujoco.MjModel) -> None:
    """Give the model of a film the colours, sizes and light of the simulated one.

    Args:
        model: Of the same scene, as `film_model` returns it; it is changed.
        simulated: Possibly changed by a condition of trials.
    """
    _paint_looks(model, simulated)
    for index in range(simulated.ngeom):
        source = simulated.geom(index)
        is_mesh = simulated.geom_type[index] == int(mujoco.mjtGeom.mjGEOM_MESH)
        if is_mesh or not source.name or source.name in _TEXTURED:
            continue
        target = model.geom(source.name)
        target.rgba[:] = source.rgba
        target.size[:] = source.size
        target.pos[:] = source.pos
        target.quat[:] = source.quat
        model.geom_sameframe[target.id] = simulated.geom_sameframe[index]
    _paint_table(model, simulated)
    _dim(model, simulated)


def _paint_looks(model: mujoco.MjModel, simulated: mujoco.MjModel) -> None:
    """Give looks the colour, size and place of the simulated geom, as far as a condition acts."""
    for index in range(model.ngeom):
        look = look_of(model.geom(index).name)
        if look is None:
            continue
        source = simulated.geom(look.object)
        original = model.geom(look.object)
        scale = float(source.size[0] / original.size[0])
        target = model.geom(index)
        target.pos[:] = scale * (target.pos - original.pos) + source.pos
        target.rgba[3] = source.rgba[3]
        if look.takes_colour:
            target.rgba[:3] = source.rgba[:3]
        mesh = int(model.geom_dataid[index])
        first = int(model.mesh_vertadr[mesh])
        model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])] *= scale
        model.geom_sameframe[index] = 0


def _paint_table(model: mujoco.MjModel, simulated: mujoco.MjModel) -> None:
    """Show a table of another colour without wood."""
    rgba = simulated.geom("table_top").rgba
    if np.allclose(rgba, TABLE_RGBA, atol=1e-3):
        return
    target = model.geom("table_top")
    target.rgba[:] = rgba
    model.geom_matid[target.id] = -1


def _dim(model: mujoco.MjModel, simulated: mujoco.MjModel) -> None:
    """Scale every light as the simulated lamp is scaled."""
    before = float(model.numeric(_KEY_DIFFUSE).data[0])
    scale = float(simulated.light("key").diffuse[0]) / before
    headlight = model.vis.headlight
    for values in (
        model.light_diffuse,
        model.light_specular,
        headlight.ambient,
        headlight.diffuse,
        headlight.specular,
    ):
        values *= scale

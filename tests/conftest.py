"""What all tests share. The environment is set here, before any library reads it."""

from __future__ import annotations

import gc
import os
import sys

os.environ["HF_HUB_OFFLINE"] = "1"  # a test that reaches for the network fails at once
os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.pop("COLUMNS", None)  # which parallel tests set; tables would fold
for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")
gc.disable()  # modules stay to the end: unwatched, they load in 11.5 s instead of 15, and tests take a twentieth less

from collections.abc import Iterator  # noqa: E402
from typing import TYPE_CHECKING  # noqa: E402

import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402

if TYPE_CHECKING:
    import mujoco

    from minidual.config.scene import SceneConfig
    from minidual.plant.world import World
    from minidual.robot.kinematics import Kinematics


settings.register_profile("any machine", deadline=None)  # no test depends on how fast one is
settings.load_profile("any machine")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of PyTorch first: of two processes that share the tests, one imports it and the other does not."""
    if not __debug__:
        raise pytest.UsageError(
            "PYTHONOPTIMIZE drops assertions, and tests without them pass: unset it"
        )
    if "torch" in sys.modules:
        raise pytest.UsageError(
            "a test module imports PyTorch as it is collected: use late.late, mark it `torch`",
        )
    items.sort(key=lambda item: item.get_closest_marker("torch") is None)


def pytest_collection_finish() -> None:
    """Collect garbage from here on, but leave out the modules."""
    gc.freeze()
    gc.enable()


def pytest_sessionfinish() -> None:
    """Leave nothing to be reported as leaked."""
    gc.unfreeze()


@pytest.fixture(scope="session")
def scene() -> SceneConfig:
    """The default scene."""
    from minidual.config.scene import SceneConfig

    return SceneConfig()


@pytest.fixture(scope="session")
def compiled_model(scene: SceneConfig) -> mujoco.MjModel:
    """The compiled model without visual meshes, shared: tests must not write to it."""
    from minidual.plant.model import build_model

    return build_model(scene, visuals=False)


@pytest.fixture(scope="session")
def visual_model(scene: SceneConfig) -> mujoco.MjModel:
    """The compiled model with visual meshes, shared: tests must not write to it."""
    from minidual.plant.model import build_model

    return build_model(scene, visuals=True)


@pytest.fixture
def world(scene: SceneConfig, compiled_model: mujoco.MjModel) -> World:
    """A fresh world on the shared model, arms at home."""
    from minidual.plant.world import World

    return World(scene, model=compiled_model)


@pytest.fixture
def visual_world(scene: SceneConfig, visual_model: mujoco.MjModel) -> World:
    """A fresh world that can be rendered, arms at home."""
    from minidual.plant.world import World

    return World(scene, model=visual_model)


@pytest.fixture
def kinematics() -> Kinematics:
    """A Pinocchio workspace of its own."""
    from minidual.robot.kinematics import Kinematics

    return Kinematics()


@pytest.fixture
def quiet_mujoco() -> Iterator[None]:
    """For tests that provoke MuJoCo's warnings: it prints them and keeps a log in the working folder."""
    import mujoco

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _message: None)
    yield
    mujoco.set_mju_user_warning(before)

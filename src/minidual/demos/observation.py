"""Observation of a world."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from minidual.plant.render import Camera, Image
from minidual.plant.world import World
from minidual.robot.pair import Array


@dataclass(frozen=True)
class Observation:
    """One instant.

    Attributes:
        time_s, image_time_s: Of joints and images, one clock.
        q, v: (n,) [rad], [rad/s].
        gripper: (2,) openings, 0 closed to 1 open.
        images: (H, W, 3) by camera.
    """

    time_s: float
    image_time_s: float
    q: Array
    v: Array
    gripper: Array
    images: dict[str, Image] = field(default_factory=dict)


class Observer:
    """Reads a world; cameras need `visuals=True`."""

    def __init__(self, world: World, cameras: Sequence[str] = ()) -> None:
        self.world = world
        self.cameras = tuple(cameras)
        self._camera = Camera.recorded(world.model, world.scene.camera) if self.cameras else None

    def read(self) -> Observation:
        """Return the current observation."""
        world = self.world
        stamp_s, q, v, gripper = world.stamp_s, world.q, world.v, world.gripper
        images: dict[str, Image] = {}
        if self._camera is not None:
            images = {name: self._camera.picture(world.data, name).copy() for name in self.cameras}
        return Observation(stamp_s, world.time, q, v, gripper, images)

    def close(self) -> None:
        """Free the renderer."""
        if self._camera is not None:
            self._camera.close()

"""LeRobot policies with their processors."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from minidual.demos.lerobot_reader import STATE, camera_key, camera_name
from minidual.errors import DataError
from minidual.policies.kinds import ChunkPolicy, Image


class Trained(NamedTuple):
    """A LeRobot policy with processors."""

    policy: Any
    preprocessor: Any
    postprocessor: Any


@contextmanager
def threads(count: int | None) -> Iterator[None]:
    """Set torch's threads temporarily; None leaves them."""
    before = torch.get_num_threads()
    torch.set_num_threads(before if count is None else count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class TorchChunkPolicy(ChunkPolicy):
    """A LeRobot policy with processors, run on `threads` threads (None: torch's default)."""

    def __init__(self, trained: Trained, threads: int | None) -> None:
        self._trained = trained
        self._threads = threads
        config = trained.policy.config
        state = config.robot_state_feature
        action = config.action_feature
        if state is None or action is None:
            raise DataError("the checkpoint does not map a state to actions")
        self.chunk_size = int(config.chunk_size)
        self.dim = int(action.shape[0])
        self._state_dim = int(state.shape[0])
        self.cameras: dict[str, tuple[int, int]] = {}
        for key, feature in config.image_features.items():
            _, height, width = feature.shape
            self.cameras[camera_name(key)] = (int(height), int(width))

    @property
    def state_dim(self) -> int:
        """See `ChunkPolicy.state_dim`."""
        return self._state_dim

    def reset(self) -> None:
        """See `ChunkPolicy.reset`."""
        self._trained.policy.reset()

    def predict(
        self,
        images: Mapping[str, Image],
        state: NDArray[np.float32],
    ) -> NDArray[np.float64]:
        """Return one chunk."""
        observation: dict[str, torch.Tensor] = {STATE: torch.from_numpy(state)}
        for camera, pixels in images.items():
            channels_first = torch.from_numpy(pixels).permute(2, 0, 1)
            observation[camera_key(camera)] = channels_first.float().div_(255.0)
        with torch.inference_mode(), threads(self._threads):
            batch = self._trained.preprocessor(observation)
            actions = self._trained.policy.predict_action_chunk(batch)
            chunk = self._trained.postprocessor(actions)
        return chunk[0].to(torch.float64).numpy()

"""LeRobot policies with their processors."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from minidual.demos.lerobot_reader import STATE, camera_name
from minidual.errors import DataError
from minidual.plant.cameras import CAMERAS
from minidual.policies.chunk_policy import ChunkPolicy, Image
from minidual.policies.draws import same_draws


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


_IMAGES = "observation.images."
_TASK = "task"


class TorchChunkPolicy(ChunkPolicy):
    """A LeRobot policy with processors, run on `threads` threads (None: torch's default).

    "observation.images.high" is the camera `high`, and so is our own "observation.images.cam_high".
    """

    def __init__(self, trained: Trained, threads: int | None) -> None:
        self._trained = trained
        self._threads = threads
        self._task = ""
        config = trained.policy.config
        state = config.robot_state_feature
        action = config.action_feature
        if state is None or action is None:
            raise DataError("the checkpoint does not map a state to actions")
        self.chunk_size = int(getattr(config, "chunk_size", 1))
        self.dim = int(action.shape[0])
        self._state_dim = int(state.shape[0])
        self.cameras: dict[str, tuple[int, int]] = {}
        self._keys: dict[str, str] = {}
        for key, feature in config.image_features.items():
            camera = _camera(key)
            _, height, width = feature.shape
            self.cameras[camera] = (int(height), int(width))
            self._keys[camera] = key

    @property
    def state_dim(self) -> int:
        """See `ChunkPolicy.state_dim`."""
        return self._state_dim

    def reset(self) -> None:
        """See `ChunkPolicy.reset`."""
        self._trained.policy.reset()

    def instruct(self, task: str) -> None:
        """See `ChunkPolicy.instruct`."""
        self._task = task

    def predict(
        self,
        images: Mapping[str, Image],
        state: NDArray[np.float32],
    ) -> NDArray[np.float64]:
        """Return one chunk."""
        observation: dict[str, Any] = {STATE: torch.from_numpy(state), _TASK: self._task}
        for camera, pixels in images.items():
            channels_first = torch.from_numpy(pixels).permute(2, 0, 1)
            observation[self._keys[camera]] = channels_first.float().div_(255.0)
        with torch.inference_mode(), threads(self._threads):
            chunk = self._answer(self._trained.preprocessor(observation))
        return chunk.to(torch.float64).numpy(force=True)

    def _answer(self, batch: Any) -> torch.Tensor:
        """Return actions (chunk_size, dim) in the units of the data."""
        actions = self._trained.policy.predict_action_chunk(batch)
        return self._trained.postprocessor(actions)[0]


class DenoisedChunkPolicy(TorchChunkPolicy):
    """A LeRobot diffusion policy that reads one look and answers in chunks."""

    def __init__(self, trained: Trained, threads: int | None) -> None:
        super().__init__(trained, threads)
        self.chunk_size = int(trained.policy.config.n_action_steps)

    def _answer(self, batch: Any) -> torch.Tensor:
        """See `TorchChunkPolicy`; equal looks have equal answers."""
        look = {**batch, STATE: batch[STATE].unsqueeze(1)}
        with same_draws():
            return super()._answer(look)


class TorchTickPolicy(TorchChunkPolicy):
    """A LeRobot policy that looks at every tick, such as diffusion, which reads the last ones."""

    own_pace = True

    def __init__(self, trained: Trained, threads: int | None) -> None:
        super().__init__(trained, threads)
        self.chunk_size = 1

    def _answer(self, batch: Any) -> torch.Tensor:
        """See `TorchChunkPolicy`; the policy queues what it predicts."""
        with same_draws():
            actions = self._trained.policy.select_action(batch)
        return self._trained.postprocessor(actions)


def _camera(key: str) -> str:
    """Return the camera of a feature: one of the scene, else a name of its own."""
    short = key.removeprefix(_IMAGES)
    return short if short in CAMERAS else camera_name(key)

"""ACT policies through LeRobot."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import draccus
import numpy as np
import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors
from lerobot.policies.pretrained import PreTrainedPolicy
from numpy.typing import NDArray
from safetensors.torch import load_file

from minidual import durable
from minidual.config.learning import TrainConfig
from minidual.demos.lerobot_reader import ACTION, IMAGE_PREFIX, STATE, camera_key
from minidual.errors import DataError, EnvironmentMissingError
from minidual.policies.batches import Stats
from minidual.policies.demonstrations import Demonstrations
from minidual.policies.kinds import REMEDY, ChunkPolicy, Image, PolicyKind, Training, TrainResult
from minidual.policies.spatial_act.configuration_spatial_act import SpatialActConfig
from minidual.policies.spatial_act.modeling_spatial_act import SpatialActPolicy
from minidual.policies.train import Trained, threads, train

REQUIRED = (
    "config.json",
    "model.safetensors",
    "policy_preprocessor.json",
    "policy_postprocessor.json",
)

_STEPS = "rename_observations", "to_batch", "device", "normalizer", "unnormalizer"
STEPS = tuple(f"{step}_processor" for step in _STEPS)
"""Steps of ACT in LeRobot's registry. None of them runs code, opens a file or connects to a server."""
STATE_BYTES_MAX = 2**24
WEIGHTS_BYTES_MAX = 2**32
SIZE_MAX = 4096
LAYERS_MAX = 16


class ActKind(PolicyKind):
    """Stock ACT with a resnet18."""

    config_class: type[PreTrainedConfig] = ACTConfig
    policy_class: type[PreTrainedPolicy] = ACTPolicy

    def make(self, config: TrainConfig, demos: Demonstrations) -> PreTrainedPolicy:
        """Return a new policy; torch's generator draws the weights."""
        alone = {"vision_backbone": "resnet18", "pretrained_backbone_weights": None}
        return ACTPolicy(ACTConfig(**alone, **_common(config, demos)))

    def require(self, device: str) -> None:
        """Raise EnvironmentMissingError for a missing device."""
        if device == "cuda" and not torch.cuda.is_available():
            missing = "the configuration asks for device 'cuda', but torch finds no CUDA device; devices here: cpu"
            remedy = "use --profile standard, or --set train.device=cpu --set deploy.device=cpu"
            raise EnvironmentMissingError(missing, remedy=remedy)

    def train(self, job: Training, folder: Path) -> TrainResult:
        """See `PolicyKind.train`."""
        config = job.config
        self.require(config.device)
        if folder.exists():
            raise DataError(
                f"the checkpoint folder {folder} exists already",
                remedy=f"{REMEDY} --force",
            )

        def build(stats: Stats) -> Trained:
            policy = self.make(config, job.demos).to(config.device)
            return Trained(policy, *make_pre_post_processors(policy.config, dataset_stats=stats))

        result, trained = train(build, job)
        with durable.replacing(folder) as partial:
            partial.mkdir(parents=True)
            for part in trained:
                part.save_pretrained(partial)
        return result

    def load(self, folder: Path, device: str, threads: int | None) -> ChunkPolicy:
        """See `PolicyKind.load`."""
        self.require(device)
        with durable.reading(f"checkpoint {folder}", f"{REMEDY} --force"):
            policy = TorchChunkPolicy(self.read(folder, device), threads)
            seen = {
                camera: np.zeros((*size, 3), np.uint8) for camera, size in policy.cameras.items()
            }
            chunk = policy.predict(
                seen,
                np.zeros(policy.dim, np.float32),
            )  # statistics may not fit the network
            if chunk.shape != (policy.chunk_size, policy.dim):
                raise ValueError(f"it emits {chunk.shape}, not {(policy.chunk_size, policy.dim)}")
        return policy

    def read(self, folder: Path, device: str = "cpu") -> Trained:
        """Read policy (in evaluation mode) and processors."""
        if missing := [name for name in REQUIRED if not (folder / name).is_file()]:
            raise DataError(
                f"checkpoint {folder} lacks {', '.join(missing)}",
                remedy=f"{REMEDY} --force",
            )
        for name in REQUIRED[2:]:
            check_processor(folder / name)
        record = durable.read_json(folder / "config.json")
        if record.pop("type") != self.config_class.get_choice_name(self.config_class):
            raise ValueError("config.json describes a policy of another type")
        # Weights to start training from would be downloaded; those of the checkpoint replace them.
        config = draccus.decode(
            self.config_class,
            record | {"device": device, "pretrained_backbone_weights": None},
        )
        check_sizes(config)
        if getattr(config, "bf16", False) and not native_bf16(device):
            config.bf16 = False  # type: ignore[attr-defined]
        policy = self.policy_class(config)
        policy.load_state_dict(read_tensors(folder / "model.safetensors"))
        policy.to(device)
        policy.eval()
        on_device = {"device_processor": {"device": device}}
        stored: dict[str, Any] = {
            "pretrained_path": str(folder),
            "preprocessor_overrides": on_device,
        }
        return Trained(policy, *make_pre_post_processors(policy.config, **stored))


class SpatialActKind(ActKind):
    """ACT with a keypoint encoder."""

    config_class = SpatialActConfig
    policy_class = SpatialActPolicy

    def make(self, config: TrainConfig, demos: Demonstrations) -> PreTrainedPolicy:
        """See `ActKind.make`; convolutions use bfloat16 where the device has it."""
        settings = {"keypoints": config.keypoints, "keyframes": demos.keyframe_ticks.shape[1]}
        return SpatialActPolicy(
            SpatialActConfig(**settings, bf16=native_bf16(config.device), **_common(config, demos)),
        )


ACT_KIND = ActKind()
SPATIAL_ACT = SpatialActKind()


def check_processor(path: Path) -> None:
    """Raise DataError unless a processor file names only STEPS, and finite statistics beside it.

    Called before LeRobot, which imports what the file names.
    """
    for number, step in enumerate(durable.read_json(path)["steps"]):
        unknown = sorted(step.keys() - {"registry_name", "config", "state_file"})
        if unknown or step["registry_name"] not in STEPS:
            named = ", ".join(f"{key} {step[key]!r:.60}" for key in (unknown or ["registry_name"]))
            raise DataError(
                f"{path}: step {number} names {named}; minidual runs only {', '.join(STEPS)}",
            )
        if "state_file" in step:
            read_tensors(path.with_name(step["state_file"]), STATE_BYTES_MAX)


def check_sizes(config: PreTrainedConfig) -> None:
    """Raise ValueError if the network would not fit a common memory."""
    sizes = {name: [value] for name, value in vars(config).items() if isinstance(value, int)}
    features = {**(config.input_features or {}), **(config.output_features or {})}
    sizes |= {name: feature.shape for name, feature in features.items()}
    for name, values in sizes.items():
        limit = LAYERS_MAX if name.endswith("_layers") else SIZE_MAX
        if not all(0 <= value <= limit for value in values):
            raise ValueError(
                f"{name} in config.json is {list(values)}; sizes here are 0 to {limit}",
            )


def read_tensors(path: Path, bytes_max: int = WEIGHTS_BYTES_MAX) -> dict[str, torch.Tensor]:
    """Read a safetensors file; DataError unless every value is a finite floating-point number."""
    tensors = load_file(durable.regular_file(path, bytes_max))
    for name, values in tensors.items():
        if not values.is_floating_point() or not bool(torch.isfinite(values).all()):
            raise DataError(
                f"{path}: '{name}' ({values.dtype}) must hold finite floating-point numbers",
            )
    return tensors


def _common(config: TrainConfig, demos: Demonstrations) -> dict[str, Any]:
    inputs = {STATE: PolicyFeature(type=FeatureType.STATE, shape=(demos.dim,))}
    for camera in demos.cameras:
        inputs[camera_key(camera)] = PolicyFeature(
            type=FeatureType.VISUAL,
            shape=(3, *demos.images[camera].shape[1:3]),
        )
    return {
        "input_features": inputs,
        "output_features": {ACTION: PolicyFeature(type=FeatureType.ACTION, shape=(demos.dim,))},
        "device": config.device,
        "push_to_hub": False,
        **{
            name: getattr(config, name)
            for name in ("chunk_size", "dim_model", "use_vae", "kl_weight", "dropout")
        },
        **{
            f"n_{name}": getattr(config, name)
            for name in ("heads", "encoder_layers", "decoder_layers")
        },
        "n_action_steps": config.chunk_size,
        "dim_feedforward": config.dim_feedforward,
        "optimizer_lr": config.learning_rate,
        "optimizer_lr_backbone": config.backbone_learning_rate,
        "optimizer_weight_decay": config.weight_decay,
    }


def native_bf16(device: str) -> bool:
    """Whether `device` computes in bfloat16; emulated, it is several times slower than float32."""
    if device == "cuda":
        return torch.cuda.is_bf16_supported()
    can = torch.cpu.get_capabilities()
    return bool(can.get("avx512_bf16") or can.get("amx_tile"))


class TorchChunkPolicy(ChunkPolicy):
    """A LeRobot policy with processors."""

    def __init__(self, trained: Trained, threads: int | None) -> None:
        self._trained = trained
        self._threads = threads
        config = trained.policy.config
        state = config.robot_state_feature
        action = config.action_feature
        if state is None or action is None or tuple(state.shape) != tuple(action.shape):
            raise DataError(
                "the checkpoint does not map a state to actions of the same joints and grippers",
            )
        self.chunk_size = int(config.chunk_size)
        self.dim = int(action.shape[0])
        self.cameras: dict[str, tuple[int, int]] = {}
        for key, feature in config.image_features.items():
            if not key.startswith(IMAGE_PREFIX):
                raise DataError(
                    f"the checkpoint reads '{key}'; cameras here are named {IMAGE_PREFIX}<name>",
                )
            self.cameras[key.removeprefix(IMAGE_PREFIX)] = (
                int(feature.shape[1]),
                int(feature.shape[2]),
            )

    def reset(self) -> None:
        """See `ChunkPolicy.reset`."""
        self._trained.policy.reset()

    def predict(
        self,
        images: Mapping[str, Image],
        state: NDArray[np.float32],
    ) -> NDArray[np.float64]:
        """Return one chunk."""
        observation: dict[str, Any] = {STATE: torch.from_numpy(state)}
        for camera, pixels in images.items():
            observation[camera_key(camera)] = (
                torch.from_numpy(pixels).permute(2, 0, 1).float().div_(255.0)
            )
        with torch.inference_mode(), threads(self._threads):
            batch = self._trained.preprocessor(observation)
            chunk = self._trained.postprocessor(self._trained.policy.predict_action_chunk(batch))
        return chunk[0].to(torch.float64).numpy()

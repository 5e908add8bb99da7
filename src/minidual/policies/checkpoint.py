"""Checkpoints in LeRobot's layout, and the progress file of an interrupted training. All writes are atomic."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import pickle
import shutil
from pathlib import Path
from typing import Any

import torch
from draccus.utils import DecodingError, ParsingError
from lerobot.configs import PreTrainedConfig
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors
from safetensors import SafetensorError
from safetensors.torch import load_model

from minidual.config.learning import TrainConfig
from minidual.errors import DataError
from minidual.policies.demonstrations import Demonstrations
from minidual.policies.spatial_act.configuration_spatial_act import SpatialActConfig
from minidual.policies.spatial_act.modeling_spatial_act import SpatialActPolicy

REMEDY = "minidual train-act"
PROGRESS_FILE = "progress.pt"
REQUIRED = ("config.json", "model.safetensors", "policy_preprocessor.json", "policy_postprocessor.json")


def save_policy(policy: ACTPolicy, preprocessor: Any, postprocessor: Any, folder: Path) -> None:
    """Write policy and processors to `folder`, which appears only when whole.

    Raises:
        DataError: `folder` exists.
    """
    if folder.exists():
        raise DataError(f"the checkpoint folder {folder} exists already", remedy="minidual train-act --force")
    partial = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    policy.save_pretrained(partial)
    preprocessor.save_pretrained(partial)
    postprocessor.save_pretrained(partial)
    for path in partial.iterdir():
        with path.open("rb") as handle:
            os.fsync(handle.fileno())
    partial.rename(folder)


def load_policy(folder: Path, device: str = "cpu") -> tuple[ACTPolicy, Any, Any]:
    """Return (policy in evaluation mode, pre-processor, post-processor) of a checkpoint, without any network.

    Raises:
        DataError: the folder or one of its files is missing or corrupt, or it is of another policy type.
    """
    missing = [name for name in REQUIRED if not (folder / name).is_file()]
    if not folder.is_dir():
        raise DataError(f"there is no checkpoint folder {folder}", remedy=REMEDY)
    if missing:
        raise DataError(f"checkpoint {folder} lacks {', '.join(missing)}", remedy=f"{REMEDY} --force")
    try:
        config = _load_config(folder, device)
        policy = SpatialActPolicy(config) if isinstance(config, SpatialActConfig) else ACTPolicy(config)
        load_model(policy, folder / "model.safetensors", strict=True, device=device)
        overrides = {"device_processor": {"device": device}}
        preprocessor, postprocessor = make_pre_post_processors(
            config, pretrained_path=str(folder), preprocessor_overrides=overrides
        )
    except DataError:
        raise
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        RuntimeError,
        SafetensorError,
        DecodingError,
        ParsingError,
    ) as error:
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise DataError(f"checkpoint {folder} cannot be read: {first}", remedy=f"{REMEDY} --force") from error
    policy.to(device)
    policy.eval()
    return policy, preprocessor, postprocessor


def _load_config(folder: Path, device: str) -> ACTConfig:
    try:
        record = json.loads((folder / "config.json").read_text())
        kind = record["type"]
    except (json.JSONDecodeError, UnicodeDecodeError, KeyError, TypeError) as error:
        raise DataError(f"{folder / 'config.json'} is no LeRobot policy configuration", remedy=REMEDY) from error
    if kind not in ("act", "spatial_act"):
        raise DataError(f"checkpoint {folder} is of policy type '{kind}'; this runtime loads act, spatial_act")
    # LeRobot parses with a command-line parser that reports a bad file on stderr and exits.
    with contextlib.redirect_stderr(io.StringIO()) as said:
        try:
            config = PreTrainedConfig.from_pretrained(folder, cli_overrides=[f"--device={device}"])
        except SystemExit as error:
            raise DataError(
                f"{folder / 'config.json'} does not parse: {said.getvalue()[:200]}", remedy=REMEDY
            ) from error
    if not isinstance(config, ACTConfig):
        raise DataError(f"checkpoint {folder} holds a {type(config).__name__}, not an ACT configuration")
    return config


def save_progress(folder: Path, progress: dict[str, Any]) -> None:
    """Write the progress of a training to `folder` through a temporary name."""
    folder.mkdir(parents=True, exist_ok=True)
    partial = folder / f".{PROGRESS_FILE}.partial"
    with partial.open("wb") as handle:
        torch.save(progress, handle)
        handle.flush()
        os.fsync(handle.fileno())
    partial.replace(folder / PROGRESS_FILE)


def load_progress(folder: Path, device: str) -> dict[str, Any] | None:
    """Return saved progress, or None if there is none; a file that cannot be read counts as none."""
    path = folder / PROGRESS_FILE
    if not path.is_file():
        return None
    try:
        return torch.load(path, map_location=device, weights_only=True)
    except (OSError, RuntimeError, EOFError, pickle.UnpicklingError):
        # Written atomically, so this is damage from outside; the training can simply start again.
        return None


def training_fingerprint(demos: Demonstrations, config: TrainConfig, seed: int) -> str:
    """Return a hash of all that the weights depend on: seed, configuration, actions, states, sampled images."""
    digest = hashlib.sha256()
    settings = config.model_dump(exclude={"time_limit_s", "loss_ratio_max", "actions_in_limits_min", "train_s_max"})
    digest.update(json.dumps([seed, settings], sort_keys=True).encode())
    digest.update(demos.state.tobytes())
    digest.update(demos.action.tobytes())
    digest.update(demos.episode_index.tobytes())
    for camera in demos.cameras:
        digest.update(camera.encode())
        digest.update(demos.images[camera][:: max(1, len(demos) // 256)].tobytes())
    return digest.hexdigest()

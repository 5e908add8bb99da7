"""The policy `spatial_act`: keypoints per camera, keyframes, then LeRobot's ACT transformer.

A supervised head predicts the keyframes, the actions at the gripper switches to come, from the
keypoints. They are ACT's environment-state token, the only one that depends on a picture
(docs/train-act.md). Where demonstrations have no keyframes, the keypoints are this token.

Source: Finn et al., Deep Spatial Autoencoders for Visuomotor Learning, 2016. Coordinates stay
float32: over 128 pixels bfloat16 resolves a quarter pixel.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.act.modeling_act import ACT, ACTPolicy
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE
from torch import Tensor, nn

from minidual.policies.spatial_act.configuration_spatial_act import SpatialActConfig

_LEAST_VARIANCE = 1e-6
_SWITCHED = 1.0
"""Least change of an opening at a switch [standard deviations]; its two values are about two apart.
"""
_MOVED = 0.2
"""Least change of another opening that takes part in the switch [standard deviations]."""
_BEGINS_BETWEEN = 0.25
"""Share of training samples that get past keyframes.

A policy that begins between two switches gets them too.
"""

_DRAW = "keyframe_draw"
"""Key of what decides this for each sample of a batch, if it was drawn before."""


class ModelOutput(NamedTuple):
    """Prediction of the model.

    Attributes:
        actions: Chunk (B, S, A).
        latent: Mean and log variance of the VAE's latent, or None.
        keyframes: (B, K, A).
    """

    actions: Tensor
    latent: tuple[Tensor | None, Tensor | None]
    keyframes: Tensor


def _same(flat: Tensor) -> Tensor:
    return flat


def _draw(n: int, device: torch.device) -> Tensor:
    return torch.rand(n, 1, 1, device=device)


class Switches:
    """Counts the switches of grippers from one look to the next.

    A look may fall into the middle of a switch: what goes on in the same direction, and a second
    gripper that follows, belong to the same switch.

    Attributes:
        past_n: Switches so far.
    """

    def __init__(self, openings: Tensor) -> None:
        self.past_n = 0
        self._reference = openings
        self._direction = torch.zeros_like(openings)

    def begin(self, commanded: Tensor) -> None:
        """Take the first commanded openings (B, G) [standard deviations of commands].

        A gripper that the first command already opens or closes does not switch: demonstrations
        count from their first command on.
        """
        change = commanded - self._reference
        self._direction = torch.where(change.abs() > _SWITCHED, change.sign(), self._direction)

    def look(self, openings: Tensor) -> None:
        """Take the openings (B, G) of the next look [standard deviations]."""
        change = openings - self._reference
        goes_on = change * self._direction > 0.0
        if bool(((change.abs() > _SWITCHED) & ~goes_on).any()):
            self.past_n += 1
            takes_part = change.abs() > _MOVED
            self._direction = torch.where(takes_part, change.sign(), self._direction)
            self._reference = openings
        else:
            self._reference = torch.where(goes_on, openings, self._reference)


class SpatialSoftmax(nn.Module):
    """Maps K channels to (B, 3 K): expected x (right), then y (down), then standard deviation.

    Image coordinates are in [-1, 1], at pixel centres.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.channels = channels
        self.log_inverse_temperature = nn.Parameter(torch.zeros(channels))

    def forward(self, logits: Tensor) -> Tensor:
        """Map logits (B, K, h, w) in float32."""
        scaled = logits.float().flatten(2) * self.log_inverse_temperature.exp().unsqueeze(1)
        height, width = logits.shape[2:]
        moments = scaled.softmax(dim=-1) @ _pixel_centres(height, width, logits.device)
        mean = moments[..., :2]
        square = moments[..., 2:]
        deviation = ((square - mean.square()).sum(-1).clamp_min(0.0) + 1e-6).sqrt()
        return torch.cat([mean[..., 0], mean[..., 1], deviation], dim=1)


def _pixel_centres(height: int, width: int, device: torch.device) -> Tensor:
    """Return x, y, x^2 and y^2 of every pixel (height * width, 4)."""
    rows = _centres(height, device)
    columns = _centres(width, device)
    y, x = torch.meshgrid(rows, columns, indexing="ij")
    x = x.flatten()
    y = y.flatten()
    return torch.stack([x, y, x.square(), y.square()], dim=1)


def _centres(n: int, device: torch.device) -> Tensor:
    """Return the centres of n pixels along an axis from -1 to 1."""
    return (torch.arange(n, dtype=torch.float32, device=device) + 0.5) * (2.0 / n) - 1.0


def _rectified(*layers: nn.Module) -> nn.Sequential:
    """Return the layers, each with a ReLU behind it."""
    parts: list[nn.Module] = []
    for layer in layers:
        parts.append(layer)
        parts.append(nn.ReLU(inplace=True))
    return nn.Sequential(*parts)


class KeypointEncoder(nn.Module):
    """Convolutions of total stride 4, then spatial softmax.

    Two layers on maps of half the size add context: features alone see 21 pixels, with these 81.
    Maps have mean 0 and deviation 1, whatever the light. `bf16`: convolve in bfloat16.
    """

    def __init__(self, keypoints: int, *, bf16: bool = False) -> None:
        super().__init__()
        self.bf16 = bf16
        self.features = _rectified(
            nn.Conv2d(3, 16, 5, stride=2, padding=2),
            nn.Conv2d(16, 16, 3, padding=1),
            nn.Conv2d(16, 64, 3, stride=2, padding=1),
            nn.Conv2d(64, 64, 3, padding=1),
        )
        half_size = nn.AvgPool2d(2, ceil_mode=True)
        dilated = [nn.Conv2d(64, 64, 3, padding=dilation, dilation=dilation) for dilation in (1, 2)]
        self.context = nn.Sequential(half_size, *_rectified(*dilated))
        self.heads = nn.Conv2d(64, keypoints, 1)
        self.pool = SpatialSoftmax(keypoints)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                if module.bias is not None:
                    nn.init.zeros_(module.bias)

    def fast_on_cpu(self) -> None:
        """Store the weights channels last, which a CPU convolves faster.

        Not when they are made: `lerobot-train` cannot save an optimiser's state of that layout.
        """
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def maps(self, image: Tensor) -> Tensor:
        """Map images (B, 3, H, W) to maps (B, K, H / 4, W / 4)."""
        with torch.autocast(image.device.type, torch.bfloat16, enabled=self.bf16):
            features = self.features(image.to(memory_format=torch.channels_last))
            context = nn.functional.interpolate(
                self.context(features),
                features.shape[-2:],
                mode="bilinear",
            )
            return self.heads(features + context)

    def forward(self, image: Tensor) -> Tensor:
        """Map images (B, 3, H, W) to (B, 3 K)."""
        maps = self.maps(image).float()
        normalised = nn.functional.layer_norm(maps, maps.shape[2:], eps=_LEAST_VARIANCE)
        return self.pool(normalised)


class PlaceWaves(nn.Module):
    """Maps keypoints (B, 3 P) to what a head reads of them: themselves, and waves of their places.

    An object may stand at either end of a picture, a few centimetres to and fro. From the places
    alone a head soon learns which end, and hardly ever the centimetres. Each octave halves the
    length of the waves, so that small moves change the features as much as large ones do.

    Source: Tancik et al., Fourier Features Let Networks Learn High Frequency Functions, 2020.

    Args:
        keypoints: Keypoints of a camera.
        cameras_n: Number of cameras.
        octaves: Number of wave lengths, the longest the width of a picture; 0: the keypoints alone.

    Attributes:
        dim: Features.
    """

    def __init__(self, keypoints: int, cameras_n: int, octaves: int) -> None:
        super().__init__()
        self._shape = (cameras_n, 3, keypoints)
        self._octaves = octaves
        places_n = cameras_n * 2 * keypoints
        self.dim = 3 * keypoints * cameras_n + 2 * octaves * places_n

    def forward(self, keypoints: Tensor) -> Tensor:
        """Map (B, 3 P) to (B, dim)."""
        if not self._octaves:
            return keypoints
        places = keypoints.unflatten(1, self._shape)[:, :, :2].flatten(1)
        octaves = torch.arange(self._octaves, device=places.device)
        phases = (places.unsqueeze(-1) * (math.pi * 2.0**octaves)).flatten(1)
        return torch.cat([keypoints, phases.sin(), phases.cos()], dim=1)


class KeyframeReader(nn.Module):
    """Encoders and keyframe head: the layers that see pictures."""

    def __init__(self, config: SpatialActConfig, action_dim: int) -> None:
        super().__init__()
        self.cameras = list(config.image_features)
        self.encoders = nn.ModuleList(
            [KeypointEncoder(config.keypoints, bf16=config.bf16) for _ in self.cameras],
        )
        self.keypoint_dim = 3 * config.keypoints * len(self.cameras)
        self.shape = (config.keyframes, action_dim)
        self.waves = PlaceWaves(config.keypoints, len(self.cameras), config.octaves)
        # Linear plus a small nonlinear branch: the map from pixels to joints is nearly linear over
        # the few centimetres that an object moves, and few demonstrations suffice for a linear map.
        keyframes_dim = math.prod(self.shape)
        self.linear = nn.Linear(self.waves.dim, keyframes_dim)
        self.hidden = nn.Sequential(
            nn.Linear(self.waves.dim, config.head_width),
            nn.ReLU(),
            nn.Linear(config.head_width, keyframes_dim),
        )

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Return keypoints (B, 3 P) and keyframes (B, K A)."""
        pairs = zip(self.encoders, self.cameras, strict=True)
        of_cameras = [encoder(batch[camera]) for encoder, camera in pairs]
        keypoints = torch.cat(of_cameras, dim=1)
        features = self.waves(keypoints)
        return keypoints, self.linear(features) + self.hidden(features)


class Glance(NamedTuple):
    """What pictures tell.

    Attributes:
        keyframes: (B, K, A).
        token: What the decoder of actions gets of them (B, K A), or the keypoints (B, 3 P).
    """

    keyframes: Tensor
    token: Tensor


class KeyframeModel(nn.Module):
    """Keyframe reader, and what a decoder of actions gets from it.

    Attributes:
        decoder_inputs: Features of the decoder: state and token.
    """

    def __init__(self, config: SpatialActConfig) -> None:
        super().__init__()
        assert config.action_feature is not None
        # LeRobot gives the module named `backbone` a learning rate of its own.
        self.backbone = KeyframeReader(config, config.action_feature.shape[0])
        token_dim = math.prod(self.backbone.shape) or self.backbone.keypoint_dim
        inputs = {
            key: feature
            for key, feature in (config.input_features or {}).items()
            if feature.type is not FeatureType.VISUAL
        }
        inputs[OBS_ENV_STATE] = PolicyFeature(type=FeatureType.ENV, shape=(token_dim,))
        self.decoder_inputs = inputs

    def glance(
        self,
        batch: dict[str, Tensor],
        filtered: Callable[[Tensor], Tensor] = _same,
    ) -> Glance:
        """Read pictures; `filtered` maps the keyframes (B, K A) to those that are used."""
        keypoints, flat = self.backbone(batch)
        keyframes = filtered(flat).unflatten(1, self.backbone.shape)
        # The decoder sees no keypoints: late ones follow the hands, and it would follow them.
        token = self._keyframe_token(batch, keyframes) if keyframes.numel() else keypoints
        return Glance(keyframes, token)

    def _keyframe_token(self, batch: dict[str, Tensor], keyframes: Tensor) -> Tensor:
        """Return the keyframes (B, K A) that the decoder gets.

        In training these are the true ones: with predicted ones, with their errors, it would learn
        to stay short of them. Past ones are 0: else nothing tells the end of a handover from the
        start of its mirror image.
        """
        token = keyframes.detach()
        if self.training and "keyframe" in batch:
            draw = batch[_DRAW] if _DRAW in batch else _draw(len(token), token.device)
            begins_between = draw < _BEGINS_BETWEEN
            to_come = batch["keyframe_is_valid"].unsqueeze(-1)
            token = torch.where(to_come, batch["keyframe"], token * begins_between)
        return token.flatten(1)


class SpatialActModel(KeyframeModel):
    """Keyframe reader and transformer."""

    def __init__(self, config: SpatialActConfig) -> None:
        super().__init__(config)
        self.act = ACT(config.transformer(self.decoder_inputs))

    def forward(
        self,
        batch: dict[str, Tensor],
        filtered: Callable[[Tensor], Tensor] = _same,
    ) -> ModelOutput:
        """Predict from a batch; `filtered` as in `glance`."""
        glance = self.glance(batch, filtered)
        inner = {key: batch[key] for key in (OBS_STATE, ACTION, "action_is_pad") if key in batch}
        inner[OBS_ENV_STATE] = glance.token
        actions, latent = self.act(inner)
        return ModelOutput(actions, latent, glance.keyframes)


class SpatialActPolicy(ACTPolicy):
    """The LeRobot policy `spatial_act`."""

    config_class: Any = SpatialActConfig
    name: Any = "spatial_act"

    def __init__(self, config: SpatialActConfig, **kwargs: Any) -> None:
        PreTrainedPolicy.__init__(self, config)  # ACTPolicy would build a resnet
        config.validate_features()
        self.config: SpatialActConfig = config
        self.model: Any = self.make_model()
        self.reset()

    def make_model(self) -> KeyframeModel:
        """Return the new network of the configuration."""
        return SpatialActModel(self.config)

    def reset(self) -> None:
        """Forget earlier observations: a new episode."""
        super().reset()
        self._total = torch.zeros(0)
        self._count = 0
        self._switches: Switches | None = None

    def fast_on_cpu(self) -> None:
        """See `KeypointEncoder.fast_on_cpu`."""
        for encoder in self.model.backbone.encoders:
            assert isinstance(encoder, KeypointEncoder)
            encoder.fast_on_cpu()

    def with_draws(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Return a training batch with the random numbers that `forward` would draw for it."""
        actions = batch[ACTION]
        return {**batch, _DRAW: _draw(len(actions), actions.device)}

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], **kwargs: Any) -> Tensor:
        """Return a chunk (B, S, A), each keyframe to come the mean of all looks since `reset`.

        The first looks are the clearest: later ones show the hands before the object, and follow
        them.
        """
        if self.training:
            self.eval()  # it visits every module: a tenth of an inference
        openings = batch[OBS_STATE][:, self.config.grippers]
        is_first = self._switches is None
        actions = self.model(batch, partial(self._mean_look, openings)).actions
        if is_first and self._switches is not None and self.config.commanded_grippers:
            self._switches.begin(actions[:, 0, self.config.commanded_grippers])
        return actions

    def _mean_look(self, openings: Tensor, flat: Tensor) -> Tensor:
        """Return the mean of the keyframes (B, K A) predicted since `reset`, 0 for past ones."""
        look = flat.unflatten(1, self.model.backbone.shape)
        if self._switches is None:
            self._switches = Switches(openings)
            self._total = torch.zeros_like(look)
            self._count = 0
        else:
            self._switches.look(openings)
        self._total = self._total + look
        self._count += 1
        mean = self._total / self._count
        mean[:, : self._switches.past_n] = 0.0
        return mean.flatten(1)

    def forward(self, batch: dict[str, Tensor], **kwargs: Any) -> tuple[Tensor, dict[str, float]]:
        """Return the loss and its parts.

        Optional `keyframe` (B, K, A): normalised actions at gripper switches; `keyframe_is_valid`
        (B, K) marks those to come.
        """
        output = self.model(batch)
        loss = _masked_l1(output.actions, batch[ACTION], ~batch["action_is_pad"])
        parts = {"l1_loss": float(loss.detach())}
        if "keyframe" in batch:
            of_keyframes = keyframe_loss(output.keyframes, batch)
            parts["keyframe_loss"] = float(of_keyframes.detach())
            loss = loss + of_keyframes
        mean, log_variance = output.latent
        if self.config.use_vae and mean is not None and log_variance is not None:
            divergence = _divergence(mean, log_variance)
            parts["kld_loss"] = float(divergence.detach())
            loss = loss + self.config.kl_weight * divergence
        return loss, parts


def keyframe_loss(keyframes: Tensor, batch: dict[str, Tensor]) -> Tensor:
    """Return the mean absolute error of the keyframes to come."""
    return _masked_l1(keyframes, batch["keyframe"], batch["keyframe_is_valid"])


def _divergence(mean: Tensor, log_variance: Tensor) -> Tensor:
    """Return the mean Kullback-Leibler divergence of normal distributions to the standard one."""
    each = -0.5 * (1 + log_variance - mean.square() - log_variance.exp())
    return each.sum(-1).mean()


def _masked_l1(predicted: Tensor, target: Tensor, valid: Tensor) -> Tensor:
    """Return the mean absolute error over `valid` (B, S)."""
    mask = valid.unsqueeze(-1)
    count = (mask.sum() * predicted.shape[-1]).clamp_min(1)
    errors = nn.functional.l1_loss(predicted, target, reduction="none")
    return (errors * mask).sum() / count

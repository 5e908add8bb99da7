"""A convolutional encoder with spatial softmax.

Source: Finn et al., Deep Spatial Autoencoders for Visuomotor Learning, 2016. Coordinates stay float32: over 128 pixels
bfloat16 resolves a quarter pixel.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

_LEAST_VARIANCE = 1e-6


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
        mean, square = moments[..., :2], moments[..., 2:]
        deviation = ((square - mean.square()).sum(-1).clamp_min(0.0) + 1e-6).sqrt()
        return torch.cat([mean[..., 0], mean[..., 1], deviation], dim=1)


def _pixel_centres(height: int, width: int, device: torch.device) -> Tensor:
    """Return x, y, x^2 and y^2 of every pixel (height * width, 4)."""
    along = [(torch.arange(n, dtype=torch.float32, device=device) + 0.5) * (2.0 / n) - 1.0 for n in (height, width)]
    y, x = (grid.flatten() for grid in torch.meshgrid(*along, indexing="ij"))
    return torch.stack([x, y, x.square(), y.square()], dim=1)


def _rectified(*layers: nn.Module) -> nn.Sequential:
    return nn.Sequential(*(part for layer in layers for part in (layer, nn.ReLU(inplace=True))))


class KeypointEncoder(nn.Module):
    """Convolutions of total stride 4, then spatial softmax.

    `context_layers` layers on maps of half the size, of dilation 1, 2, ..., add what stands around a place: features alone
    see 21 pixels, with two layers 81. `standardised` maps have mean 0 and deviation 1, whatever the light.
    `bf16`: convolve in bfloat16.
    """

    def __init__(self, keypoints: int, *, context_layers: int = 0, standardised: bool = False) -> None:
        super().__init__()
        self.standardised = standardised
        self.features = _rectified(
            nn.Conv2d(3, 32, 5, stride=2, padding=2),
            nn.Conv2d(32, 32, 3, padding=1),
            nn.Conv2d(32, 64, 3, stride=2, padding=1),
            nn.Conv2d(64, 64, 3, padding=1),
        )
        around = [nn.Conv2d(64, 64, 3, padding=2**k, dilation=2**k) for k in range(context_layers)]
        self.context = nn.Sequential(nn.AvgPool2d(2, ceil_mode=True), *_rectified(*around)) if around else None
        self.heads = nn.Conv2d(64, keypoints, 1)
        self.pool = SpatialSoftmax(keypoints)
        self.bf16 = False
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                if module.bias is not None:
                    nn.init.zeros_(module.bias)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def maps(self, image: Tensor) -> Tensor:
        """Map images (B, 3, H, W) to maps (B, K, H / 4, W / 4)."""
        with torch.autocast(image.device.type, torch.bfloat16, enabled=self.bf16):
            features = self.features(image.to(memory_format=torch.channels_last))
            if self.context is not None:
                size = features.shape[-2:]
                features = features + functional.interpolate(self.context(features), size, mode="bilinear")
            maps = self.heads(features)
        if not self.standardised:
            return maps
        flat = maps.float().flatten(2)
        return functional.layer_norm(flat, flat.shape[2:], eps=_LEAST_VARIANCE).view(maps.shape)

    def forward(self, image: Tensor) -> Tensor:
        """Map images (B, 3, H, W) to (B, 3 K)."""
        return self.pool(self.maps(image))

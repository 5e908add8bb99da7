"""A convolutional encoder with spatial softmax.

Source: Finn et al., Deep Spatial Autoencoders for Visuomotor Learning, 2016. Coordinates stay float32: over 128 pixels
bfloat16 resolves a quarter pixel.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

_LEAST_DEVIATION = 1e-3


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
        batch, channels, height, width = logits.shape
        scaled = logits.float() * self.log_inverse_temperature.exp().view(1, -1, 1, 1)
        weights = scaled.reshape(batch, channels, height * width).softmax(dim=-1).view(batch, channels, height, width)
        xs = _pixel_centres(width, logits.device)
        ys = _pixel_centres(height, logits.device)
        along_x = weights.sum(dim=2)
        along_y = weights.sum(dim=3)
        x = along_x @ xs
        y = along_y @ ys
        variance = along_x @ xs.square() - x.square() + along_y @ ys.square() - y.square()
        return torch.cat([x, y, (variance.clamp_min(0.0) + 1e-6).sqrt()], dim=1)


def _pixel_centres(count: int, device: torch.device) -> Tensor:
    return (torch.arange(count, dtype=torch.float32, device=device) + 0.5) * (2.0 / count) - 1.0


class KeypointEncoder(nn.Module):
    """Convolutions of total stride 4, then spatial softmax.

    `context_layers` layers on maps of half the size, of dilation 1, 2, ..., add what stands around a place: features alone
    see 21 pixels, with two layers 81. `standardised` maps have mean 0 and deviation 1, whatever the light.
    `bf16`: convolve in bfloat16, which where native doubles the training rate.
    """

    def __init__(
        self,
        keypoints: int,
        widths: tuple[int, int, int] = (32, 32, 64),
        *,
        context_layers: int = 0,
        standardised: bool = False,
    ) -> None:
        super().__init__()
        first, second, third = widths
        self.standardised = standardised
        self.features = nn.Sequential(
            nn.Conv2d(3, first, 5, stride=2, padding=2),
            nn.ReLU(inplace=True),
            nn.Conv2d(first, second, 3, padding=1),
            nn.ReLU(inplace=True),
            nn.Conv2d(second, third, 3, stride=2, padding=1),
            nn.ReLU(inplace=True),
            nn.Conv2d(third, third, 3, padding=1),
            nn.ReLU(inplace=True),
        )
        around: list[nn.Module] = []
        for k in range(context_layers):
            around += [nn.Conv2d(third, third, 3, padding=2**k, dilation=2**k), nn.ReLU(inplace=True)]
        self.context = nn.Sequential(nn.AvgPool2d(2, ceil_mode=True), *around) if around else None
        self.heads = nn.Conv2d(third, keypoints, 1)
        self.pool = SpatialSoftmax(keypoints)
        self.bf16 = False
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                if module.bias is not None:
                    nn.init.zeros_(module.bias)

    def maps(self, image: Tensor) -> Tensor:
        """Map images (B, 3, H, W) to maps (B, K, H / 4, W / 4)."""
        with torch.autocast(image.device.type, torch.bfloat16, enabled=self.bf16):
            features = self.features(image)
            if self.context is not None:
                size = features.shape[-2:]
                features = features + functional.interpolate(self.context(features), size, mode="bilinear")
            maps = self.heads(features)
        if not self.standardised:
            return maps
        maps = maps.float()
        mean, deviation = maps.mean((2, 3), keepdim=True), maps.std((2, 3), keepdim=True)
        return (maps - mean) / (deviation + _LEAST_DEVIATION)

    def forward(self, image: Tensor) -> Tensor:
        """Map images (B, 3, H, W) to (B, 3 K)."""
        return self.pool(self.maps(image))

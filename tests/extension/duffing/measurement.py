"""A measurement model: the angle at which somebody beside the spring sees the mass."""

from typing import final

import torch
from torch import Tensor

from ahnn.arguments import Positive, checked
from ahnn.measurements import Time


@final
@checked
class Bearing:
    """atan(q / distance), seen from `distance` in m beside the position at rest."""

    names, units = ("bearing",), ("rad",)

    def __init__(self, distance: Positive) -> None:
        self.distance = distance

    def __call__(self, x: Tensor, t: Time) -> Tensor:
        """Return the angles (..., 1) of the states x (..., 2)."""
        return torch.atan(x[..., :1] / self.distance)

    def locate(self, y: Tensor, t: Time) -> Tensor:
        """Return the positions (..., 1); only training on measurements needs it."""
        return self.distance * torch.tan(y)

"""Affine scalings of the state, fitted on the training split.

The scaling is part of the vector field: the network receives scaled coordinates, and its gradient is pulled
back to the physical state by the chain rule. Hamilton's equations then hold exactly for any scaling, even for
one scale per component, which is not canonical by itself in more than one dimension.
"""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn

from ahnn.arguments import checked
from ahnn.errors import UserError

Kind = Literal["minmax", "block", "none"]


UNEVEN = 30.0
"""Ratio of ranges, or of energies, from which coordinates have separate scales."""
ROUNDING = 1e-9
"""Ratio below which a component counts as constant except for rounding."""


@checked
class Affine(nn.Module):
    """Affine map z = (x - shift) / scale, with constants stored in the checkpoint.

    Args:
        kind: `minmax` maps each component to [-1, 1] (the paper); `block` shares one scale among the
            positions and one among the momenta, except for components that vary `UNEVEN` times less than
            others and would otherwise have little effect; `none` is the identity.
        size: number of components.
    """

    shift: Tensor
    scale: Tensor

    def __init__(self, kind: Kind, size: int) -> None:
        super().__init__()
        self.kind = kind
        self.register_buffer("shift", torch.zeros(size))
        self.register_buffer("scale", torch.ones(size))

    def fit(self, minimum: Tensor, maximum: Tensor) -> None:
        """Set shift and scale from the extremes of the components, both of shape (size,).

        Raises:
            UserError: a component is constant.
        """
        if self.kind == "none":
            return
        half = (maximum - minimum) / 2
        if self.kind == "block":
            ratio = half / half.max()
            half = torch.where((ratio > ROUNDING) & (ratio * UNEVEN < 1), half, half.max())
        if not bool((half > 0).all()):
            message = (
                f"scaling {self.kind}: expected components that vary over the training split; "
                f"received ranges {(2 * half).tolist()}. Drop the constant component or use scaling none."
            )
            raise UserError(message)
        self.shift.copy_((maximum + minimum) / 2)
        self.scale.copy_(half)

    def forward(self, x: Tensor) -> Tensor:
        """Return scaled coordinates, shape (..., size)."""
        return (x - self.shift) / self.scale

    def inverse(self, z: Tensor) -> Tensor:
        """Return physical coordinates, shape (..., size)."""
        return self.shift + self.scale * z

    def pullback(self, gradient: Tensor) -> Tensor:
        """Return the gradient with respect to x from the one with respect to z, shape (..., size)."""
        return gradient / self.scale

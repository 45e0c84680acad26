"""A batch as a least-squares problem in the parameters of a module: residuals and their Jacobian."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.func import functional_call, jacrev, vmap


class LeastSquares(NamedTuple):
    """Residuals r(theta) of a batch, as functions of the flat parameter vector theta, shape (P,).

    Attributes:
        residuals: theta -> r, shape (N,).
        jacobian: theta -> dr/dtheta, shape (N, P).
    """

    residuals: Callable[[Tensor], Tensor]
    jacobian: Callable[[Tensor], Tensor]


class _Residuals(nn.Module):
    """The residual function of a module as a forward pass, which `functional_call` can parametrise."""

    def __init__(self, module: nn.Module, function: Callable[..., Tensor]) -> None:
        super().__init__()
        self.module, self.function = module, function

    def forward(self, *batch: Tensor) -> Tensor:
        return self.function(*batch)


def least_squares(
    module: nn.Module, function: Callable[..., Tensor], batch: tuple[Tensor, ...]
) -> LeastSquares:
    """Return the problem of a batch.

    The Jacobian takes one vectorised backward pass per residual of a sample, over all samples at once.

    Args:
        module: its parameters are the unknowns.
        function: residuals of a batch, computed with the module; sample by sample independent.
        batch: tensors of shape (B, ...).
    """
    wrapped = _Residuals(module, function)
    shapes = {name: p.shape for name, p in wrapped.named_parameters()}

    def named(theta: Tensor) -> dict[str, Tensor]:
        parts = theta.split([shape.numel() for shape in shapes.values()])
        return {name: part.view(shape) for (name, shape), part in zip(shapes.items(), parts, strict=True)}

    def of_sample(theta: Tensor, *sample: Tensor) -> Tensor:
        return functional_call(wrapped, named(theta), tuple(s.unsqueeze(0) for s in sample)).flatten()

    def residuals(theta: Tensor) -> Tensor:
        with torch.no_grad():
            return functional_call(wrapped, named(theta), batch).flatten()

    def jacobian(theta: Tensor) -> Tensor:
        dimensions = (None, *(0 for _ in batch))
        return vmap(jacrev(of_sample), dimensions)(theta, *batch).flatten(0, 1)

    return LeastSquares(residuals, jacobian)

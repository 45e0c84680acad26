"""A flow for many steps, while its parameters stay as they are: what only they determine is computed once.

The steps themselves are done in C where there is a compiler, to rounding those of `written_out`: a block of
members at a time, whose numbers stay in the cache, with one exponential for an activation and its slope.
"""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from ahnn.cores import each, slices
from ahnn.dynamics.gradients import Layers
from ahnn.dynamics.native import KNOWN, Scheme, table
from ahnn.integrators.tableaus import ButcherTableau
from ahnn.libraries import NUMBER as N
from ahnn.libraries import PART, compiled_library, numbers_alone, plain
from ahnn.libraries import POINTER as P
from ahnn.types import Flow, TimeStep

ROWS = 8
"""Rows of a panel, as the library has them."""


@cache
def library() -> ctypes.CDLL | None:
    """Return the library, or None where there is no C compiler."""
    signatures = {"ahnn_step": (N, N, N, N, N, N, P, P, P, P, N, P)}
    return compiled_library(Path(__file__).with_name("steps.c"), signatures, "a rollout", vectors=True)


def steady_flow(flow: Flow, layers: Layers, scheme: Scheme) -> Flow:
    """Return a flow in C, or the flow itself where the library, the activation or its numbers are missing.

    Args:
        flow: what it stands for, and what is asked where derivatives are wanted.
        layers: of its field.
        scheme: its method and activation; of any step.
    """
    known = scheme.activation.value in KNOWN and plain(layers.last, torch.float64)
    if not known or library() is None:
        return flow
    return SteadyFlow(flow, layers, scheme.tableau, KNOWN.index(scheme.activation.value))


class SteadyFlow:
    """A flow along the gradient of a network by an explicit Runge-Kutta method, its parameters fixed."""

    def __init__(self, flow: Flow, layers: Layers, tableau: ButcherTableau, activation: int) -> None:
        units, inputs = layers.weights[0].shape
        self.flow = flow
        self.tableau, self.constants = table(tableau, torch.float64), _constants(layers)
        self.sizes = inputs, units, len(layers.weights), activation, len(tableau.b)

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states (B, D) after dt."""
        if not (numbers_alone(x, dt) and x.shape[1] == self.sizes[0]):
            return self.flow(x, dt)
        x, h = x.contiguous(), torch.as_tensor(dt, dtype=torch.float64).contiguous()
        out = torch.empty_like(x)
        if len(x) <= PART:
            self._follow(x, h, out)
            return out

        def follow(part: slice) -> None:
            self._follow(x[part], h[part] if h.numel() > 1 else h, out[part])

        each(follow, slices(len(x), PART), x.device)
        return out

    def _follow(self, x: Tensor, h: Tensor, out: Tensor) -> None:
        """Write the states after h to `out`.

        Raises:
            MemoryError: there is none for a block of members.
        """
        found = library()
        assert found is not None
        fixed = *self.sizes, self.tableau.data_ptr(), self.constants.data_ptr()
        if found.ahnn_step(len(x), *fixed, x.data_ptr(), h.data_ptr(), int(h.numel() > 1), out.data_ptr()):
            message = "rollout: no memory for a block of members"
            raise MemoryError(message)


def _constants(layers: Layers) -> Tensor:
    """Return weights and biases upwards, those of the output, weights downwards, the matrix E by panels."""
    upwards = zip(layers.weights, layers.biases, strict=True)
    downwards = [*(w.T for w in layers.weights[:0:-1]), layers.leave.T]
    parts = [part for w, b in upwards for part in (_panels(w), _filled(b))]
    return torch.cat([*parts, _filled(layers.last), *map(_panels, downwards)])


def _filled(rows: Tensor) -> Tensor:
    """Return rows, and zeros up to a whole panel."""
    return torch.cat((rows, rows.new_zeros(-len(rows) % ROWS, *rows.shape[1:])))


def _panels(matrix: Tensor) -> Tensor:
    """Return the numbers of a matrix, panel by panel and there column by column."""
    return _filled(matrix).unflatten(0, (-1, ROWS)).mT.flatten()

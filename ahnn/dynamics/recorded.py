"""A flow as one recorded sequence of operations: the same numbers, without Python between them.

On the 13 sigma points of one state a small network costs more in Python than in arithmetic; replayed, the
sequence takes a quarter of the time. Only flows whose operations do not depend on the numbers are recorded:
explicit integrators and maps, and no iteration to convergence.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ahnn.dynamics.fields import HamiltonianDynamics, NeuralODE
from ahnn.dynamics.maps import NextState
from ahnn.integrators.explicit import ExplicitRungeKutta
from ahnn.integrators.symplectic import SymmetricComposition
from ahnn.types import Flow, TimeStep

SETTLED = 3
"""Calls after which a recording is as fast as it gets."""


def recorded(flow: Flow) -> Flow:
    """Return a flow with the same values, bit for bit, for one step length at a time and without gradients.

    Dynamics whose operations depend on the numbers, and functions of which nothing is known, come back as
    they are.
    """
    integrated = isinstance(flow, HamiltonianDynamics | NeuralODE)
    fixed = integrated and isinstance(flow.integrator, ExplicitRungeKutta | SymmetricComposition)
    return _Recorded(flow) if fixed or isinstance(flow, NextState) else flow


class _Recorded:
    """Recordings of a flow, one for each shape of the states."""

    def __init__(self, flow: Flow) -> None:
        self.flow = flow
        self._known: dict[torch.Size, Callable[[Tensor, Tensor], Tensor]] = {}

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states (B, D) after dt."""
        step = torch.as_tensor(dt, dtype=torch.float64)
        known = self._known.get(x.shape)
        if known is None:
            known = self._known[x.shape] = _record(self.flow, x, step)
        return known(x, step)


def _record(flow: Flow, x: Tensor, dt: Tensor) -> Callable[[Tensor, Tensor], Tensor]:
    with torch.inference_mode(mode=False), torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it is deprecated for deployment; shapes are fixed here
        example = x.clone(), dt.clone()
        trace: Any = torch.jit.trace
        known = trace(lambda x, dt: flow(x, dt), example, check_trace=False)
    for _ in range(SETTLED):
        known(x, dt)
    return known

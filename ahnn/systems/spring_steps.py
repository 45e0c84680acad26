"""Exact flow of a mass on a spring in C, if a compiler is available, with the bits of the formulas."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor

from ahnn.compiled_libraries import NUMBER as N
from ahnn.compiled_libraries import POINTER as P
from ahnn.compiled_libraries import REAL as R
from ahnn.compiled_libraries import compiled_library, numbers_alone
from ahnn.integrators import GaussLegendre4
from ahnn.jacobians import differenced
from ahnn.substeps import substeps
from ahnn.types import Flow, TimeStep


@cache
def library() -> ctypes.CDLL | None:
    """Return the C library, or None without a C compiler."""
    source = Path(__file__).with_name("spring_steps.c")
    signature = (N, R, R, R, R, N, N, R, P, P)
    return compiled_library(source, {"ahnn_spring_steps": signature}, "the data of springs")


class SpringFlow:
    """Gauss-Legendre steps for states (B, 2) on the CPU.

    Other states, steps that differ between members, and states whose stages do not converge use `flow`.

    Args:
        flow: equivalent flow, from `exact_flow`.
        stiffness: spring constant.
        mass: mass on the spring.
        method: the method, with its tolerance.
        longest: longest undivided step.
    """

    def __init__(
        self, flow: Flow, stiffness: float, mass: float, method: GaussLegendre4, longest: float
    ) -> None:
        self.flow, self.longest = flow, longest
        self.constants = stiffness, mass, method.tolerance, method.round_off(torch.float64)
        self.most = method.max_iterations

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states (B, 2) after dt."""
        single = not isinstance(dt, Tensor) or dt.ndim == 0
        found = library() if single and numbers_alone(x, dt) and x.shape[1] == 2 else None
        if found is None:
            return self.flow(x, dt)
        x, parts = x.contiguous(), substeps(dt, self.longest)
        out = torch.empty_like(x)
        own = len(x), *self.constants, self.most, parts, float(dt) / parts, x.data_ptr(), out.data_ptr()
        return self.flow(x, dt) if found.ahnn_spring_steps(*own) else out

    def transition(self, x: Tensor, dt: TimeStep) -> tuple[Tensor, Tensor]:
        """Return the states (B, 2) after dt, and the state transitions (B, 2, 2)."""
        return differenced(self, x, dt, cast(Any, self.flow).half)

"""Exact flow of satellites of an oblate planet in C, if a compiler is available."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor

from ahnn.compiled_libraries import NUMBER as N
from ahnn.compiled_libraries import PART, REAL, CompiledFlow, compiled_library, numbers_alone
from ahnn.compiled_libraries import POINTER as P
from ahnn.cores import each, slices
from ahnn.integrators import SymmetricComposition
from ahnn.jacobians import differenced
from ahnn.substeps import substeps, substeps_of_each
from ahnn.types import Flow, TimeStep


class OblateAttraction(NamedTuple):
    """Constants of the equations of motion.

    Attributes:
        mass: mass of the satellite.
        central: -mass mu.
        oblateness: 3/2 J2 r_eq^2.
    """

    mass: float
    central: float
    oblateness: float


@cache
def library() -> ctypes.CDLL | None:
    """Return the C library, or None without a C compiler."""
    signatures = {
        "ahnn_oblate_steps": (N, N, P, P, REAL, REAL, REAL, N, P, P, N, P),
        "ahnn_oblate_flow": (P, N, P, REAL, P),
    }
    source = Path(__file__).with_name("oblate.c")
    return compiled_library(source, signatures, "the data of orbits", vectors=True)


class OblateConstants(ctypes.Structure):
    """Constants of a flow, as in oblate.c."""

    _fields_ = (
        *(("stages", N), ("drifts", P), ("kicks", P)),
        *(("mass", REAL), ("attraction", REAL), ("oblateness", REAL), ("longest", REAL)),
    )


class OblateFlow:
    """Composition of leapfrog steps for states (B, 6) on the CPU; other states use `flow`.

    Args:
        flow: equivalent flow, from `exact_flow`.
        constants: constants of the equations of motion.
        method: the composition.
        longest: longest undivided step.
    """

    def __init__(
        self, flow: Flow, constants: OblateAttraction, method: SymmetricComposition, longest: float
    ) -> None:
        self.flow, self.constants, self.longest = flow, constants, longest
        self.drifts, self.kicks = (torch.tensor(own, dtype=torch.float64) for own in method.weights)

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states (B, 6) after dt."""
        if not (numbers_alone(x, dt) and x.shape[1] == 6) or library() is None:
            return self.flow(x, dt)
        x = x.contiguous()
        if not isinstance(dt, Tensor) or dt.numel() == 1:
            count = substeps(float(dt), self.longest)
            return self._followed(x, torch.tensor(float(dt) / count, dtype=torch.float64), count)
        h = dt.to(torch.float64).contiguous()
        counts = substeps_of_each(h.abs().nan_to_num(), self.longest)
        if bool((counts != counts[0]).any()):  # results must not depend on other members
            out = torch.empty_like(x)
            for count in counts.unique():
                own = counts == count
                out[own] = self._followed(x[own], h[own] / count, int(count))
            return out
        return self._followed(x, h / counts[0], int(counts[0]))

    def as_compiled(self) -> CompiledFlow | None:
        """Return the flow for loops in C, or None without a C compiler."""
        found = library()
        if found is None:
            return None
        own = len(self.kicks), self.drifts.data_ptr(), self.kicks.data_ptr(), *self.constants, self.longest
        about = OblateConstants(*own)
        function = ctypes.cast(found.ahnn_oblate_flow, P).value
        assert function is not None
        return CompiledFlow(function, ctypes.addressof(about), (found, about, self.drifts, self.kicks))

    def _followed(self, x: Tensor, h: Tensor, count: int) -> Tensor:
        """Propagate states (B, 6) over `count` steps of length h, () or (B,)."""
        out = torch.empty_like(x)
        if len(x) <= PART:
            self._follow(x, h, count, out)
            return out

        def follow(part: slice) -> None:
            self._follow(x[part], h[part] if h.numel() > 1 else h, count, out[part])

        each(follow, slices(len(x), PART), x.device)
        return out

    def transition(self, x: Tensor, dt: TimeStep) -> tuple[Tensor, Tensor]:
        """Return the states (B, 6) after dt, and the state transitions (B, 6, 6)."""
        return differenced(self, x, dt, cast(Any, self.flow).half)

    def _follow(self, x: Tensor, h: Tensor, count: int, out: Tensor) -> None:
        """Write the states after `count` steps of length h to `out`."""
        found = library()
        assert found is not None
        fixed = len(self.kicks), self.drifts.data_ptr(), self.kicks.data_ptr(), *self.constants
        own = x.data_ptr(), h.data_ptr(), int(h.numel() > 1), out.data_ptr()
        found.ahnn_oblate_steps(len(x), *fixed, count, *own)

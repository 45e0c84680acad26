"""Integrator steps and their backward pass in C, the main cost of first-order training.

The library replaces about a hundred torch operations of `fused_steps`, one block of members at a time.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.compiled_libraries import NUMBER as N
from ahnn.compiled_libraries import POINTER as P
from ahnn.compiled_libraries import compiled_library, followed, plain
from ahnn.cores import each, slices
from ahnn.dynamics.activations import ACTIVATIONS, Activation
from ahnn.integrators.tableaus import ButcherTableau

KNOWN = tuple(ACTIVATIONS[name].value for name in ("gelu", "tanh", "silu"))
"""Activations in the order of their numbers in the C library."""
PART = 512
"""Number of states that justifies one more core with its own partial sums."""
KEPT = 1 << 22
"""Size of a step's record, in bytes, above which recomputing is faster than reading it."""


class Scheme(NamedTuple):
    """Non-differentiated properties of a step: method, step length h, activation."""

    tableau: ButcherTableau
    h: float | Tensor
    activation: Activation


DEFINED = {torch.float32: (), torch.float64: ("DOUBLE",)}
"""Preprocessor macros of the C source for each dtype."""


@cache
def library(dtype: torch.dtype = torch.float32) -> ctypes.CDLL | None:
    """Return the library for a dtype in `DEFINED`, or None without a C compiler."""
    signatures = {
        "ahnn_kept": (N, N, N, N, N),
        "ahnn_increment": (N, N, N, N, N, N, P, P, P, P, N, P, P, P, P),
    }
    source = Path(__file__).with_name("reverse.c")
    whose = "first-order training"
    return compiled_library(source, signatures, whose, vectors=True, defined=DEFINED[dtype])


def applies(scheme: Scheme, x: Tensor, tensors: Sequence[Tensor]) -> bool:
    """Return whether the library supports a step from x, (B, D), with these parameters."""
    dtype, steps = x.dtype, (scheme.h,) if isinstance(scheme.h, Tensor) else ()
    fits = x.ndim == 2 and len(x) > 0 and x.shape[1] == tensors[0].shape[1]
    fits = fits and all(t.shape == (len(x), 1) for t in steps)
    known = scheme.activation.value in KNOWN and dtype in DEFINED
    known = known and all(plain(t, dtype) for t in (x, *steps, *tensors))
    return fits and known and not followed() and library(dtype) is not None


@cache
def table(tableau: ButcherTableau, dtype: torch.dtype) -> Tensor:
    """Return the weights of the stages and of the step, (stages + 1, stages)."""
    count = len(tableau.b)
    rows = [(*row, *(0.0,) * (count - len(row))) for row in ((), *tableau.a, tableau.b)]
    return torch.tensor(rows, dtype=dtype, device="cpu")


class Increment:
    """One step from states x, (B, D), with its forward and backward pass.

    Args:
        scheme: supported method, step h (a number or (B, 1)) and activation.
        x: (B, D) states.
        tensors: weights and biases of the layers, output weights and E.
    """

    def __init__(self, scheme: Scheme, x: Tensor, tensors: Sequence[Tensor]) -> None:
        tableau, h, activation = scheme
        self.x, self.tensors = x.contiguous(), [t.contiguous() for t in tensors]
        self.h = torch.as_tensor(h, dtype=x.dtype, device=x.device).contiguous()
        self.table, self.library = table(tableau, x.dtype), _found(x.dtype)
        units, inputs = self.tensors[0].shape
        self.sizes = inputs, units, len(tensors) // 2 - 1, KNOWN.index(activation.value), len(tableau.b)
        self.parts = slices(len(x), PART)

    def room(self) -> Tensor | None:
        """Allocate memory for the record that the backward pass reads; None if recomputing is faster."""
        inputs, units, depth, _, stages = self.sizes
        count = self.library.ahnn_kept(min(len(self.x), PART), inputs, units, depth, stages)
        bytes_kept = self.x.element_size() * count * len(self.parts)
        return self.x.new_empty(len(self.parts), count) if bytes_kept <= KEPT else None

    def follow(self, room: Tensor | None = None) -> Tensor:
        """Return the increment, (B, D), and store the record for the backward pass in `room`."""
        return self._call(None, room)[0]

    def follow_back(self, v: Tensor, room: Tensor | None = None) -> tuple[Tensor, list[Tensor]]:
        """Return v . d(increment)/dx, (B, D), and v . d(increment)/dtensors; v is (B, D).

        `room` is the memory filled by the forward pass; its content is overwritten.
        """
        moved, sums = self._call(v.contiguous(), room)
        parts = sums.split([t.numel() for t in self.tensors])
        return moved, [part.view_as(t) for part, t in zip(parts, self.tensors, strict=True)]

    def _call(self, v: Tensor | None, room: Tensor | None) -> tuple[Tensor, Tensor]:
        """Return the requested result, (B, D), and the concatenated gradients.

        Raises:
            MemoryError: not enough memory for a block of members.
        """
        x, h, out = self.x, self.h, torch.empty_like(self.x)
        sums = x.new_empty(len(self.parts), 0 if v is None else sum(t.numel() for t in self.tensors))
        given = (P * len(self.tensors))(*(t.data_ptr() for t in self.tensors))
        fixed = *self.sizes, self.table.data_ptr(), given

        def work(k: int) -> None:
            part, kept = self.parts[k], None if room is None else room[k].data_ptr()
            steps = h[part] if h.ndim else h
            pull = None if v is None else v[part].data_ptr()
            read = x[part].data_ptr(), steps.data_ptr(), h.ndim // 2, pull
            if self.library.ahnn_increment(
                len(x[part]), *fixed, *read, kept, out[part].data_ptr(), sums[k].data_ptr()
            ):
                message = "training: not enough memory for a block of members"
                raise MemoryError(message)

        each(work, range(len(self.parts)), x.device)
        return out, sums.sum(0) if len(self.parts) > 1 else sums[0]


def _found(dtype: torch.dtype) -> ctypes.CDLL:
    found = library(dtype)
    assert found is not None
    return found

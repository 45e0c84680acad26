"""Optimiser steps whose loss and gradient are one function, compiled or, on a GPU, recorded.

Autograd then has one node between parameters and loss, and nothing is dispatched operation by operation.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, cast

from torch import Tensor, nn
from torch.autograd import Function

from ahnn.dynamics import Dynamics
from ahnn.training.compilation import Program
from ahnn.training.objectives import Objective
from ahnn.training.steppers import FirstOrder
from ahnn.training.tracing import Compared, Traced, tensors, traced
from ahnn.types import Window

log = logging.getLogger(__name__)


class Compiled(FirstOrder):
    """Steps by the gradient of such a loss; batches of another size, and failures, are left to autograd.

    Args:
        batch_size: of the batches that are worth a program, all but the last of an epoch.
        make: what turns the graph of such a loss into a program.
    """

    def __init__(self, batch_size: int, make: Callable[[Traced], Program]) -> None:
        self.batch_size, self.make = batch_size, make
        self.programs: dict[Any, Program] = {}
        self.failed = False

    def step(
        self, objective: Objective, loss: nn.Module, dynamics: Dynamics, batch: Any, optimizer: Any
    ) -> Tensor:
        """Return the loss of the batch, with a graph of one node."""
        compared = Compared(objective, loss, dynamics)
        program = None
        if not self.failed and len(batch.start) == self.batch_size:
            program = self._program(_key(objective, batch), compared, batch)
        if program is None:
            return super().step(objective, loss, dynamics, batch, optimizer)
        parameters = list(compared.parameters())
        found = _Known.apply(program, [*tensors(batch), *parameters, *compared.buffers()], *parameters)
        value = cast(Tensor, found)
        return value if batch.weight == 1 else value * batch.weight

    def _program(self, key: Any, compared: nn.Module, batch: Window) -> Program | None:
        """Return the compiled loss of such batches; None, with a warning, where it cannot be had."""
        if key not in self.programs:
            try:
                self.programs[key] = self.make(traced(compared, batch))
            except Exception as error:  # a missing compiler, or what a compiler makes of the graph
                self.failed = True
                log.warning(
                    "compile: expected optimiser steps that can be compiled; received %s (%s). The training "
                    "goes on without; install g++, or set compile=false",
                    type(error).__name__,
                    " ".join(str(error).split())[:200],
                )
        return self.programs.get(key)


class _Known(Function):
    """A loss whose gradients come with it."""

    @staticmethod
    def forward(ctx: Any, program: Program, inputs: list[Tensor], *parameters: Tensor) -> Tensor:
        del parameters
        value, *gradients = program.call(*inputs)
        found = iter(gradients)
        ctx.gradients = [next(found) if touched else None for touched in program.touched]
        return value.clone()  # what is recorded is written over by the next step

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        by = cotangents[0]
        return None, None, *(g if g is None else g * by for g in ctx.gradients)


def _key(objective: Objective, batch: Window) -> Any:
    """Return what a compiled function depends on besides the model."""
    dt = None if isinstance(batch.dt, Tensor) else batch.dt
    return objective, batch.start.shape, batch.increments.shape, batch.start.dtype, dt

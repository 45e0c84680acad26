"""Optimiser steps on a GPU whose loss and gradients are one recording of kernels (a CUDA graph).

A step of a small network is several hundred kernels of a few microseconds each: launched one by one, they
leave the GPU waiting for the next most of the time. A recording is launched at once. Autograd then has one
node between parameters and loss, and nothing is dispatched operation by operation.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.autograd import Function

from ahnn.dynamics import Dynamics
from ahnn.integrators import GaussLegendre4
from ahnn.training.objectives import Derivative, Objective, Recursive
from ahnn.training.steppers import FirstOrder
from ahnn.training.tracing import Compared, Traced, tensors, traced
from ahnn.types import Window

log = logging.getLogger(__name__)

WARM = 3
"""Calls before the recording, in which libraries choose kernels and take their memory."""


class Program(NamedTuple):
    """A function of a batch and the tensors of a model.

    Attributes:
        call: (start, increments, dt if it is a tensor, parameters, buffers) -> loss and its gradients.
        touched: parameters that the loss depends on; the others have no gradient.
    """

    call: Callable[..., Any]
    touched: list[bool]


def can_record(trainer: Any, model: Any) -> bool:
    """Return whether all steps of a training are the same kernels on one GPU."""
    dynamics = model.dynamics
    integrator = getattr(dynamics, "integrator", None)
    fixed = _is_own(dynamics) and (integrator is None or _is_own(integrator))
    objectives = {type(phase.objective) for phase in model.curriculum.phases}
    return (
        trainer.strategy.root_device.type == "cuda"
        and model.automatic_optimization
        and objectives <= {Recursive, Derivative}
        and fixed
        and not isinstance(integrator, GaussLegendre4)  # its iterations end when they have converged
        and trainer.world_size == 1
        and trainer.precision == "32-true"
    )


def _is_own(part: object) -> bool:
    return type(part).__module__.startswith("ahnn.")


class RecordedStep(FirstOrder):
    """Steps by the gradient of such a loss; batches of another size, and failures, are left to autograd.

    Args:
        batch_size: of the batches that are recorded, all but the last of an epoch.
        make: what turns the graph of such a loss into a program.
    """

    def __init__(self, batch_size: int, make: Callable[[Traced], Program] | None = None) -> None:
        self.batch_size, self.make = batch_size, make or recording
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
        """Return the recording of such batches; None, with a warning, where it cannot be made."""
        if key not in self.programs:
            try:
                self.programs[key] = self.make(traced(compared, batch))
            except Exception as error:  # an operation that cannot be recorded, or no memory for its results
                self.failed = True
                log.warning(
                    "cuda_graphs: expected optimiser steps that can be recorded; received %s (%s). The "
                    "training goes on without",
                    type(error).__name__,
                    " ".join(str(error).split())[:200],
                )
        return self.programs.get(key)


def recording(traced: Traced) -> Program:
    """Return a program that copies its arguments to where the recorded kernels read them, and replays these.

    Each call writes over the results of the one before.

    Args:
        traced: with arguments on a GPU.
    """
    held = [t.clone() for t in traced.arguments]
    device = held[0].device
    beside = torch.cuda.Stream(device)
    beside.wait_stream(torch.cuda.current_stream(device))
    with torch.no_grad(), torch.cuda.stream(beside):
        for _ in range(WARM):
            traced.graph(*held)
    torch.cuda.current_stream(device).wait_stream(beside)
    graph = torch.cuda.CUDAGraph()
    with torch.no_grad(), torch.cuda.graph(graph, capture_error_mode="thread_local"):
        found = traced.graph(*held)

    def call(*given: Tensor) -> list[Tensor]:
        torch._foreach_copy_(held, [*given])  # pyright: ignore[reportPrivateImportUsage]
        graph.replay()
        return found

    call.reads = traced.graph  # pyright: ignore[reportFunctionMemberAccess] - the kernels read its constants
    return Program(call, traced.touched)


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
    """Return what a recording depends on besides the model."""
    dt = None if isinstance(batch.dt, Tensor) else batch.dt
    return objective, batch.start.shape, batch.increments.shape, batch.start.dtype, dt

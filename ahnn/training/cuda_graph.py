"""Optimiser steps on a GPU with loss and gradients recorded as a CUDA graph.

A step of a small network consists of several hundred kernels of a few microseconds each: launched one by one,
they leave the GPU idle most of the time. A recording is launched as a whole. Autograd then has one node
between parameters and loss, and no operations are dispatched individually.
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
"""Number of calls before recording, during which libraries choose kernels and allocate memory."""


class Program(NamedTuple):
    """Function of a batch and the tensors of a model.

    Attributes:
        call: (start, increments, dt if it is a tensor, parameters, buffers) -> loss and its gradients.
        touched: parameters that the loss depends on; other parameters have no gradient.
    """

    call: Callable[..., Any]
    touched: list[bool]


def can_record(trainer: Any, model: Any) -> bool:
    """Return whether all training steps launch the same kernels on one GPU."""
    dynamics = model.dynamics
    integrator = getattr(dynamics, "integrator", None)
    fixed = _is_own(dynamics) and (integrator is None or _is_own(integrator))
    objectives = {type(phase.objective) for phase in model.curriculum.phases}
    return (
        trainer.strategy.root_device.type == "cuda"
        and model.automatic_optimization
        and objectives <= {Recursive, Derivative}
        and fixed
        and not isinstance(integrator, GaussLegendre4)  # the number of iterations depends on data
        and trainer.world_size == 1
        and trainer.precision == "32-true"
    )


def _is_own(part: object) -> bool:
    return type(part).__module__.startswith("ahnn.")


class RecordedStep(FirstOrder):
    """Training steps with recorded gradients; batches of other sizes, or after a failure, use autograd.

    Args:
        batch_size: size of the recorded batches, all but the last of an epoch.
        make: function that converts the graph of a loss to a program.
    """

    def __init__(self, batch_size: int, make: Callable[[Traced], Program] | None = None) -> None:
        self.batch_size, self.make = batch_size, make or recording
        self.programs: dict[Any, Program] = {}
        self.failed = False

    def step(
        self, objective: Objective, loss: nn.Module, dynamics: Dynamics, batch: Any, optimizer: Any
    ) -> Tensor:
        """Return the loss of the batch, with a one-node autograd graph."""
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
        """Return the recording for a kind of batch; None, with a warning, if recording fails."""
        if key not in self.programs:
            try:
                self.programs[key] = self.make(traced(compared, batch))
            except Exception as error:  # an operation that cannot be recorded, or insufficient memory
                self.failed = True
                log.warning(
                    "cuda_graphs: expected optimiser steps that can be recorded; received %s (%s). The "
                    "training continues without them",
                    type(error).__name__,
                    " ".join(str(error).split())[:200],
                )
        return self.programs.get(key)


def recording(traced: Traced) -> Program:
    """Return a program that copies its arguments to the recorded kernels' inputs and replays the kernels.

    Each call overwrites the previous results.

    Args:
        traced: traced graph with arguments on a GPU.
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

    call.reads = traced.graph  # pyright: ignore[reportFunctionMemberAccess] - constants read by the kernels
    return Program(call, traced.touched)


class _Known(Function):
    """Loss with precomputed gradients."""

    @staticmethod
    def forward(ctx: Any, program: Program, inputs: list[Tensor], *parameters: Tensor) -> Tensor:
        del parameters
        value, *gradients = program.call(*inputs)
        found = iter(gradients)
        ctx.gradients = [next(found) if touched else None for touched in program.touched]
        return value.clone()  # recorded results are overwritten by the next step

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        by = cotangents[0]
        return None, None, *(g if g is None else g * by for g in ctx.gradients)


def _key(objective: Objective, batch: Window) -> Any:
    """Return the key of a recording: everything that it depends on besides the model."""
    dt = None if isinstance(batch.dt, Tensor) else batch.dt
    return objective, batch.start.shape, batch.increments.shape, batch.start.dtype, dt

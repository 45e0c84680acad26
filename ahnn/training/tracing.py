"""Tracing of the loss of a batch and its gradient as one graph, including the backward pass."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from ahnn.dynamics import Dynamics
from ahnn.training.objectives import Objective
from ahnn.types import Window


class Compared(nn.Module):
    """The loss of a batch as a module."""

    def __init__(self, objective: Objective, loss: nn.Module, dynamics: Dynamics) -> None:
        super().__init__()
        self.objective, self.loss, self.dynamics = objective, loss, dynamics

    def forward(self, batch: Window) -> Tensor:
        """Return the loss, a scalar."""
        return self.loss(self.objective.residuals(self.dynamics, batch))


class Traced(NamedTuple):
    """The loss of a batch and its gradients as a traced graph.

    Attributes:
        graph: graph with the arguments of `Program.call`.
        touched: parameters that the loss depends on.
        arguments: example arguments.
    """

    graph: torch.fx.GraphModule
    touched: list[bool]
    arguments: list[Tensor]


def traced(compared: nn.Module, batch: Window) -> Traced:
    """Trace a loss and its gradients.

    Args:
        compared: module from a batch to its loss; its parameters and buffers become arguments of the graph.
        batch: example batch; the graph accepts batches of its shape and with the same number dt.
    """
    from torch.fx.experimental.proxy_tensor import make_fx

    names, constants = dict(compared.named_parameters()), dict(compared.named_buffers())
    touched = list[bool]()

    def loss_and_gradients(*given: Tensor) -> list[Tensor]:
        start, increments, *rest = given
        dt = rest.pop(0) if isinstance(batch.dt, Tensor) else batch.dt
        own = [p.detach().requires_grad_() for p in rest[: len(names)]]
        held = dict(zip([*names, *constants], [*own, *rest[len(names) :]], strict=True))
        with torch.enable_grad():
            value = torch.func.functional_call(compared, held, (Window(start, increments, dt),))
            found = torch.autograd.grad(value, own, allow_unused=True)
        touched[:] = [g is not None for g in found]
        return [value.detach(), *(g for g in found if g is not None)]

    arguments = [t.detach() for t in (*tensors(batch), *names.values(), *constants.values())]
    with torch.no_grad():
        graph = make_fx(loss_and_gradients)(*arguments)
    return Traced(graph, touched, arguments)


def tensors(batch: Window) -> list[Tensor]:
    """Return the tensors of a batch."""
    return [batch.start, batch.increments, *([batch.dt] if isinstance(batch.dt, Tensor) else [])]

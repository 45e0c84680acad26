"""The same work in plain PyTorch: the field is autograd's gradient, with its graph."""

from __future__ import annotations

from collections.abc import Callable

import torch
from timing import Work
from torch import Tensor, nn

ACTIVATIONS = {"gelu": nn.GELU, "tanh": nn.Tanh}
Increment = Callable[[nn.Module, Tensor, float], Tensor]


def network(width: int, depth: int, activation: str, size: int) -> nn.Module:
    """Return a scalar network of the states, (B, 1)."""
    parts: list[nn.Module] = []
    for _ in range(depth):
        parts += [nn.Linear(size, width), ACTIVATIONS[activation]()]
        size = width
    return nn.Sequential(*parts, nn.Linear(width, 1))


def field(energy: nn.Module, x: Tensor) -> Tensor:
    """Return J grad H, (B, D)."""
    with torch.enable_grad():
        x = x if x.requires_grad else x.detach().requires_grad_()
        (gradient,) = torch.autograd.grad(energy(x).sum(), x, create_graph=True)
    dq, dp = gradient.chunk(2, dim=-1)
    return torch.cat((dp, -dq), dim=-1)


def increment(energy: nn.Module, x: Tensor, dt: float) -> Tensor:
    """Return the increment of one classical Runge-Kutta step, (B, D)."""
    k1 = field(energy, x)
    k2 = field(energy, x + dt / 2 * k1)
    k3 = field(energy, x + dt / 2 * k2)
    k4 = field(energy, x + dt * k3)
    return dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def torchdiffeq_increment(energy: nn.Module, x: Tensor, dt: float) -> Tensor:
    """Return the increment of one step of torchdiffeq's `rk4` (the 3/8 rule), (B, D)."""
    from torchdiffeq import odeint

    times = torch.tensor((0.0, dt), dtype=x.dtype)
    found = odeint(lambda t, x: field(energy, x), x, times, method="rk4")  # noqa: ARG005
    assert isinstance(found, Tensor)
    return found[1] - x


def loss(net: nn.Module, follow: Increment, start: Tensor, targets: Tensor, dt: float) -> Tensor:
    """Return the Huber loss of W recursive predictions of W increments (B, W, D)."""
    x, residual, residuals = start, torch.zeros_like(start), []
    for target in targets.unbind(1):
        predicted = follow(net, x, dt)
        x, residual = x + predicted, residual + predicted - target
        residuals.append(residual)
    found = torch.stack(residuals, 1)
    return nn.functional.huber_loss(found, torch.zeros_like(found))


def training_step(
    net: nn.Module, follow: Increment, start: Tensor, targets: Tensor, dt: float, steps: int
) -> Work:
    """Return work: optimiser steps with AdamW on the Huber loss of W recursive predictions."""
    optimizer = torch.optim.AdamW(net.parameters(), lr=1e-3)

    def work() -> None:
        for _ in range(steps):
            optimizer.zero_grad()
            loss(net, follow, start, targets, dt).backward()
            optimizer.step()

    return work


def rollout(net: nn.Module, follow: Increment, start: Tensor, dt: float, steps: int) -> Work:
    """Return work: all states of a rollout."""

    def work() -> None:
        x, states = start, []
        for _ in range(steps):
            x = (x + follow(net, x, dt)).detach()
            states.append(x)
        torch.stack(states, 1)

    return work

"""The measured work, by ahnn and by each installed peer."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
import torch_peer
from timing import Row, Work, has, in_turn, products
from torch import Tensor

from ahnn.dynamics import HamiltonianDynamics
from ahnn.rollouts import rollout
from ahnn.training import FirstOrder, LossOptions, Stepper
from ahnn.training.loss import Loss
from ahnn.training.objectives import Recursive
from ahnn.types import Window

SIZE, DT, STAGES = 6, 0.05, 4
NEEDS = {
    "torchdiffeq": ("torchdiffeq",),
    "JAX": ("jax", "equinox", "optax"),
    "diffrax": ("jax", "equinox", "optax", "diffrax"),
}
"""Packages that a peer is made of."""
TRAINING = (
    ("2x64 gelu, window 1, batch 256", 64, 2, "gelu", 1, 256),
    ("2x64 tanh, window 1, batch 256", 64, 2, "tanh", 1, 256),
    ("2x64 gelu, window 5, batch 256", 64, 2, "gelu", 5, 256),
    ("3x128 gelu, window 1, batch 1024", 128, 3, "gelu", 1, 1024),
)
ROLLOUTS = (("125 orbits, 2x40 gelu, float64", 40, 2), ("125 orbits, 3x128 gelu, float64", 128, 3))


def dynamics(width: int, depth: int, activation: str) -> HamiltonianDynamics:
    """Return a generic Hamiltonian of three degrees of freedom through rk4."""
    torch.manual_seed(0)
    network = {"width": width, "depth": depth, "activation": activation}
    options = {
        "hamiltonian": "generic",
        "inertia": 1.0,
        "mu": None,
        "inputs": "cartesian",
        "scaling": "block",
    }
    return HamiltonianDynamics(3, network=network, integrator={"name": "rk4"}, **options)  # pyright: ignore[reportArgumentType]


def own_step(
    width: int, depth: int, activation: str, batch: Window, steps: int, stepper: Stepper | None = None
) -> Work:
    """Return work: optimiser steps of ahnn, as `recipe=first_order` takes them, without Lightning.

    They are taken where the batch is.
    """
    learned = dynamics(width, depth, activation).to(batch.start.device)
    loss = Loss(SIZE, LossOptions()).to(batch.start.device)
    objective, stepper = Recursive(loss, batch.increments.shape[1]), stepper or FirstOrder()
    optimizer = torch.optim.AdamW(learned.parameters(), lr=1e-3, fused=True)

    def work() -> None:
        for _ in range(steps):
            optimizer.zero_grad()
            stepper.step(objective, loss, learned, batch, optimizer).backward()
            optimizer.step()

    return work


def training(repeats: int) -> Iterator[Row]:
    """Yield a row for each size of training step."""
    for name, width, depth, activation, window, batch in TRAINING:
        generator = torch.Generator().manual_seed(1)
        start = torch.randn(batch, SIZE, generator=generator)
        targets = 0.01 * torch.randn(batch, window, SIZE, generator=generator)
        steps = max(1, 10 * 256 // (batch * window))
        own = width, depth, activation, Window(start, targets, DT), steps
        works = {"ahnn": own_step(*own)}
        for peer, follow in torch_peers():
            net = torch_peer.network(width, depth, activation, SIZE)
            works[peer] = torch_peer.training_step(net, follow, start, targets, DT, steps)
        if has(NEEDS["JAX"]):
            import jax_peer

            net = jax_peer.network(width, depth, activation, SIZE, jax_peer.jnp.float32)
            works["JAX"] = jax_peer.training_step(net, start.numpy(), targets.numpy(), DT, steps)
        # Up and down in the forward pass, and four times as much in its reverse.
        count = 6 * batch * (SIZE * width + (depth - 1) * width**2) * STAGES * window * steps
        row = in_turn(name, works, repeats, products(batch, width, count, torch.float32))
        yield per(row, steps)


def rollouts(repeats: int, steps: int = 60) -> Iterator[Row]:
    """Yield a row for each size of rollout, times of 1,440 steps."""
    for name, width, depth in ROLLOUTS:
        generator = torch.Generator().manual_seed(1)
        start = 0.3 * torch.randn(125, SIZE, generator=generator, dtype=torch.float64)
        flow = dynamics(width, depth, "gelu").frozen()
        works: dict[str, Work] = {"ahnn": lambda flow=flow, start=start: rollout(flow, start, DT, steps + 1)}
        for peer, follow in torch_peers():
            net = torch_peer.network(width, depth, "gelu", SIZE).double()
            works[peer] = torch_peer.rollout(net, follow, start, DT, steps)
        if has(NEEDS["JAX"]):
            import jax_peer

            net = jax_peer.network(width, depth, "gelu", SIZE, jax_peer.jnp.float64)
            works["JAX"] = jax_peer.rollout(net, start.numpy(), DT, steps)
            if has(NEEDS["diffrax"]):
                works["diffrax"] = jax_peer.diffrax_rollout(net, start.numpy(), DT, steps)
        count = 2 * len(start) * (SIZE * width + (depth - 1) * width**2) * STAGES * steps
        row = in_turn(name, works, repeats, products(len(start), width, count, torch.float64))
        yield per(row, steps / 1440)


def torch_peers() -> Iterator[tuple[str, Callable[[torch.nn.Module, Tensor, float], Tensor]]]:
    """Yield the peers in PyTorch with their Runge-Kutta steps."""
    yield "autograd.grad", torch_peer.increment
    if has(NEEDS["torchdiffeq"]):
        yield "torchdiffeq", torch_peer.torchdiffeq_increment


def per(row: Row, amount: float) -> Row:
    """Return a row with all times divided by an amount."""
    times = {who: [t / amount for t in found] for who, found in row.times.items()}
    return row._replace(times=times, floor=row.floor and [t / amount for t in row.floor])

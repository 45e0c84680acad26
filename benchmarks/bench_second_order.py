"""A step of Levenberg-Marquardt compared with its floor and with a jitted step.

    python benchmarks/bench_second_order.py [repeats]

The floor is the time of the necessary multiply-adds, as plain matrix products: half of the Gram
matrix (N P^2 / 2) and the products in the Jacobian in float32, the factor (P^3 / 6) in float64. With one
core, times are CPU time; with two, wall time, which needs an idle machine. optimistix, if installed, takes a
jitted step on the same number of residuals of the same network, in float64.
"""

from __future__ import annotations

import os
import sys
import time

import torch
from timing import Row, Work, has, in_turn, left_out, settle, table

from ahnn.dynamics import HamiltonianDynamics
from ahnn.training import (
    Derivative,
    LeastSquaresProblem,
    LevenbergMarquardt,
    Loss,
    LossOptions,
    Objective,
    Recursive,
)
from ahnn.types import Window

TASKS = {"generic orbit, 2x40": (3, 40, 5000), "spring, 2x24": (1, 24, 7500)}
"""Degrees of freedom, width and batch of the recipes `eccentric` and `second_order_long`."""
NEEDS = {"optimistix": ("jax", "equinox", "optax", "optimistix")}
WARM = 6
"""Steps before the one that is measured."""
DT, WINDOW, ORDER, STAGES = 0.05, 5, 12, 4


def dynamics(dof: int, width: int) -> HamiltonianDynamics:
    """Return a generic Hamiltonian in double precision through rk4."""
    torch.manual_seed(0)
    network = {"width": width, "depth": 2, "activation": "tanh"}
    options = {"hamiltonian": "generic", "inertia": 1.0, "mu": None, "inputs": "cartesian"}
    options |= {"scaling": "block", "network": network, "integrator": {"name": "rk4"}}
    return HamiltonianDynamics(dof, **options).double()  # pyright: ignore[reportArgumentType]


def oscillations(dof: int, batch: int) -> Window:
    """Return windows of oscillators with exact increments."""
    generator = torch.Generator().manual_seed(1)
    q, p = torch.randn(2, batch, 1, dof, generator=generator, dtype=torch.float64)
    w = torch.linspace(1, 1.3, dof, dtype=torch.float64)
    turn = DT * torch.arange(ORDER + 1, dtype=torch.float64)[:, None] * w
    x = torch.cat((q * turn.cos() + p / w * turn.sin(), p * turn.cos() - q * w * turn.sin()), dim=-1)
    return Window(x[:, 0], x.diff(dim=1), DT)


def step(objective: Objective, own: HamiltonianDynamics, batch: Window) -> Work:
    """Return work: one step, always from the same weights."""
    parts = objective.divided(batch)

    def problems() -> tuple[LeastSquaresProblem, LeastSquaresProblem]:  # as the stepper makes them
        return objective.problem(own, parts[0]), objective.problem(own, parts[1])

    begun = LevenbergMarquardt(own.parameters())
    for _ in range(WARM):
        begun.step(problems)
    damping = 3 * begun.param_groups[0]["damping"]  # a step that is taken at once, as nearly all are
    state = {name: value.clone() for name, value in own.state_dict().items()}

    def work() -> None:
        own.load_state_dict(state)
        optimizer = LevenbergMarquardt(own.parameters(), damping=damping)
        optimizer.step(problems)
        assert optimizer.param_groups[0]["damping"] < 4 * damping, "the step was not taken at once"

    return work


def by_optimistix(dof: int, width: int, batch: Window) -> Work:
    """Return work: a step of optimistix on the field at the starts, less slopes from the increments."""
    import jax_peer

    net = jax_peer.network(width, 2, "tanh", 2 * dof, jax_peer.jnp.float64)
    return jax_peer.second_order(net, batch.start.numpy(), batch.increments[:, 0].numpy() / DT)


def floor(rows: int, count: int, inputs: int, width: int, stages: int, threads: int) -> Work:
    """Return the matrix products of a step with so many residuals and parameters."""
    jacobian, half = torch.randn(rows, count), torch.randn(rows, count // 2)
    narrow, wide = (torch.randn(count // 6, count, dtype=torch.float64) for _ in range(2))
    layer, units = torch.randn(rows, width), torch.randn(width, width)
    # Two outer products, and up and down through the layers, in each stage.
    passes = round(stages * (2 * count + 2 * width * (inputs + width)) / width**2)

    def work() -> None:
        torch.set_num_threads(threads)
        torch.mm(half.T, jacobian)
        torch.mm(wide.T, narrow)
        for _ in range(passes):
            torch.mm(layer, units)
        torch.set_num_threads(1)

    return work


def measured(repeats: int, threads: int) -> list[Row]:
    """Return a row for each task and objective."""
    os.environ["OMP_NUM_THREADS"] = str(threads)
    clock = time.process_time if threads == 1 else time.perf_counter
    rows = []
    for task, (dof, width, size) in TASKS.items():
        batch = oscillations(dof, size)
        loss = Loss(2 * dof, LossOptions())
        loss.unit.copy_(batch.increments.flatten(0, 1).square().mean(0).sqrt())
        count = sum(p.numel() for p in dynamics(dof, width).parameters())
        for name, objective, stages in (
            ("derivatives", Derivative(loss, ORDER), 1),
            (f"window {WINDOW}", Recursive(loss, WINDOW), STAGES),
        ):
            products = floor(size // 5 * 2 * dof, count, 2 * dof, width, stages, threads)
            works = {
                "ahnn": step(objective, dynamics(dof, width), batch),
            }
            if threads == 1 and name == "derivatives" and has(NEEDS["optimistix"]):
                works["optimistix"] = by_optimistix(dof, width, oscillations(dof, size // 5))
            cores = "1 core" if threads == 1 else f"{threads} cores"
            rows.append(in_turn(f"{task}, {name}, {cores}", works, repeats, products, clock))
    return rows


def steps(repeats: int) -> str:
    """Return the table, on one core and on two."""
    return table([row for threads in (1, 2) for row in measured(repeats, threads)], "one step [ms]")


def main() -> None:
    """Measure and print the table."""
    repeats = int(sys.argv[1]) if len(sys.argv) > 1 else 7
    settle()
    left_out(NEEDS)
    print(steps(repeats))


if __name__ == "__main__":
    main()

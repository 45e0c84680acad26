"""Jacobians of steps along a learned force: closed form compared with vectorised reverse mode.

    python benchmarks/bench_step_jacobians.py [repeats]

20,000 steps of dopri5 of a satellite, in float32: most of the time of training on measurements. The wide
network is used for the final step in function space.
"""

from __future__ import annotations

import sys

import torch
from timing import in_turn, settle, table
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import HamiltonianDynamics
from ahnn.dynamics.variations import jacobians_of_steps, mapped_jacobians_of_steps

NETWORKS = {"two layers of 24": (24, 2), "one layer of 128": (128, 1), "one layer of 384": (384, 1)}


def satellite(width: int, depth: int) -> HamiltonianDynamics:
    """Return p^2 / 2 + V(q) with V(q) of direction and distance."""
    torch.manual_seed(0)
    network = {"width": width, "depth": depth, "activation": "gelu"}
    options = {"hamiltonian": "mechanical", "inertia": 1.0, "mu": None, "inputs": "isotropic"}
    options |= {"scaling": "block", "network": network, "integrator": {"name": "dopri5"}}
    return HamiltonianDynamics(3, **options).double()  # pyright: ignore[reportArgumentType]


def main(repeats: int) -> None:
    """Measure and print."""
    settle()
    x = torch.randn(50, 400, 6, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    dt, rows = torch.full((50, 400), 0.01, dtype=torch.float64), []
    for name, (width, depth) in NETWORKS.items():
        own = satellite(width, depth)
        theta = parameters_to_vector(own.parameters()).detach()
        ways = {"ahnn": jacobians_of_steps(own), "reverse mode": mapped_jacobians_of_steps(own)}
        works = {way: lambda f=f, theta=theta: f(theta, x, dt) for way, f in ways.items()}
        rows.append(in_turn(name, works, repeats))
    print(table(rows, "20,000 steps, network of [ms]"))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)

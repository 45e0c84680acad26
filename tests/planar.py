"""Learned Hamiltonians of two degrees of freedom, small and with scalings other than one."""

from __future__ import annotations

import torch
from helpers import generator

from ahnn.dynamics import HamiltonianDynamics


def planar(
    structure="mechanical", *, mu=None, falloff=0.0, inputs="isotropic", method="dopri5", **network
) -> HamiltonianDynamics:
    torch.manual_seed(0)
    own = HamiltonianDynamics(
        2,
        hamiltonian=structure,
        inertia=2.0,
        mu=mu,
        falloff=falloff,
        inputs=inputs,
        scaling="block",
        network={"width": 5, "depth": 2, "activation": "gelu", **network},
        integrator={"name": method},
    ).double()
    for name, buffer in own.named_buffers():
        if name.endswith(("unit", "spread", "scale", "nearest", "middle", "shift")):
            buffer.copy_(torch.rand(buffer.shape, generator=generator(3), dtype=torch.float64) + 0.5)
    return own

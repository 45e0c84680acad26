"""Exported modules: flow step and energy as functions of states and, if needed, a clock."""

from __future__ import annotations

import copy
import math
from typing import cast

import torch
from torch import Tensor, nn

from ahnn.clock import Clock, extended, reduced
from ahnn.dynamics import Dynamics, HasEnergy
from ahnn.dynamics.activations import Activation
from ahnn.dynamics.lagrangian import LagrangianDynamics
from ahnn.dynamics.networks import Perceptron
from ahnn.errors import UserError
from ahnn.integrators import GaussLegendre4

SPACING, TERMS = 0.5, 13
"""Step and number of terms of the sum for the normal distribution; its error is below 4e-16."""


class StepModule(nn.Module):
    """One step dt of a flow, from states x, shape (B, D), to states (B, D)."""

    def __init__(self, dynamics: Dynamics, dt: float) -> None:
        super().__init__()
        self.dynamics, self.dt = dynamics, dt

    def forward(self, x: Tensor) -> Tensor:
        """Return the next states, shape (B, D)."""
        return self.dynamics(x, self.dt)


class ClockedStepModule(nn.Module):
    """One step of a flow whose forces depend on time or controls, which are constant over the step."""

    def __init__(self, dynamics: Dynamics, dt: float) -> None:
        super().__init__()
        self.dynamics, self.dt = dynamics, dt

    def forward(self, x: Tensor, clock: Tensor) -> Tensor:
        """Return the states (B, D) after a step from x, given time and controls (B, k)."""
        rates = torch.cat((torch.ones_like(clock[:, :1]), torch.zeros_like(clock[:, 1:])), dim=-1)
        return reduced(self.dynamics(extended(x, Clock(clock, rates)), self.dt), self.dynamics.clock)


class EnergyModule(nn.Module):
    """Learned Hamiltonian, shape (B,), at states of shape (B, D)."""

    def __init__(self, dynamics: Dynamics) -> None:
        super().__init__()
        self.dynamics = dynamics

    def forward(self, x: Tensor) -> Tensor:
        """Return H, shape (B,)."""
        return cast(HasEnergy, self.dynamics).energy(x)


def modules(dynamics: Dynamics, dt: float) -> dict[str, nn.Module]:
    """Return the modules to export, by name: `flow`, and `energy` of a model with a Hamiltonian.

    Raises:
        UserError: an implicit integrator, with a data-dependent number of iterations, or a Lagrangian
            network.
    """
    integrator = getattr(dynamics, "integrator", None)
    if isinstance(integrator, GaussLegendre4):
        message = (
            f"integrator {integrator.name}: expected an explicit one, whose steps are a graph of fixed "
            "length; received an implicit one, which iterates until it is solved. Train with rk4 or a "
            "composition"
        )
        raise UserError(message)
    if isinstance(dynamics, LagrangianDynamics):
        message = (
            "export: expected dynamics that can be exported as a graph; received a Lagrangian network, whose "
            "second derivatives require reverse-mode differentiation. Use model=hnn"
        )
        raise UserError(message)
    own = portable(dynamics)
    found: dict[str, nn.Module] = {"flow": (ClockedStepModule if own.clock else StepModule)(own, dt)}
    if isinstance(own, HasEnergy):
        found["energy"] = EnergyModule(own)
    return found


def portable(dynamics: Dynamics) -> Dynamics:
    """Return a copy without the error function, which ONNX runtimes lack in double precision."""
    own = copy.deepcopy(dynamics)
    for module in own.modules():
        if isinstance(module, Perceptron) and module.activation.value is torch.nn.functional.gelu:
            module.activation = GELU
    return own


def normal(z: Tensor) -> Tensor:
    """Return the normal distribution function from exponentials only.

    The trapezoidal rule for the integral of erfc, with its poles accounted for, converges exponentially
    (Chiarella & Reichl 1968, Math. Comp. 22, 137; Hunter & Regan 1972, Math. Comp. 26, 539).
    """
    x = z.abs() / math.sqrt(2)
    squares = [((k + 0.5) * SPACING) ** 2 for k in range(TERMS)]
    total = math.exp(-squares[0]) / (x * x + squares[0])
    for square in squares[1:]:
        total = total + math.exp(-square) / (x * x + square)
    tail = SPACING / math.pi * x * torch.exp(-x * x) * total + 1 / (1 + torch.exp(2 * math.pi / SPACING * x))
    return torch.where(z < 0, tail, 1 - tail)


def _slope(z: Tensor) -> tuple[Tensor, Tensor]:
    cumulative = normal(z)
    return z * cumulative, cumulative + z * torch.exp(-0.5 * z * z) * (1 / math.sqrt(2 * math.pi))


GELU = Activation(lambda z: z * normal(z), _slope)
"""The activation `gelu`, x Phi(x), without the error function."""

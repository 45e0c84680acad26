"""Jacobians of integrator steps with respect to their initial states, by variational equations.

A one-step method commutes with derivatives: the Jacobian of a step along dx/dt = f is the same step along
dY/dt = f_x Y (Hairer, Lubich & Wanner, Geometric Numerical Integration, lemma VI.4.1). The integrators thus
apply unchanged to states augmented with variations.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import partial
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from ahnn.clock import split
from ahnn.cores import each, slices
from ahnn.dynamics.base import Dynamics, require_step
from ahnn.dynamics.derivatives import parametrised
from ahnn.dynamics.energies import Energy
from ahnn.dynamics.fields import HamiltonianDynamics
from ahnn.dynamics.forced import Forced, total
from ahnn.dynamics.forces import Instant
from ahnn.dynamics.hamiltonians import GenericHamiltonian, SeparableHamiltonian
from ahnn.integrators import ExplicitRungeKutta, SymmetricComposition
from ahnn.jacobians import step_jacobians
from ahnn.types import VectorField

SAMPLES = 1000
"""Number of steps whose Jacobians are formed at once, so that their data fit into the cache."""

StepJacobians = Callable[[Tensor, Tensor, Tensor], Tensor]
"""(theta (P,), states (B, N, D), lengths (B, N)) -> dx(t + dt)/dx(t) of each step, (B, N, D, D)."""


def jacobians_of_steps(dynamics: Dynamics, dtype: torch.dtype = torch.float32) -> StepJacobians:
    """Return the Jacobians of steps, computed in `dtype`: in closed form for known structures."""
    narrow = copy.deepcopy(dynamics).requires_grad_(False)
    if not isinstance(narrow, HamiltonianDynamics):
        return mapped_jacobians_of_steps(narrow, dtype)
    field, method = varied(narrow.field), narrow.integrator
    if field is None or not isinstance(method, ExplicitRungeKutta | SymmetricComposition):
        return mapped_jacobians_of_steps(narrow, dtype)
    narrow.to(dtype)

    def jacobians(theta: Tensor, states: Tensor, lengths: Tensor) -> Tensor:
        vector_to_parameters(theta.to(dtype), narrow.parameters())
        x, dt = states.flatten(0, 1).to(dtype), lengths.flatten().to(dtype).unsqueeze(-1)

        def rows(part: slice) -> Tensor:
            return jacobian_along(lambda z: z + method.increment(field, z, dt[part]), x[part])

        return torch.cat(each(rows, slices(len(x), SAMPLES), x.device)).unflatten(0, lengths.shape)

    return jacobians


def own_jacobians(
    dynamics: Dynamics, dtype: torch.dtype = torch.float32
) -> Callable[[Tensor, Tensor], Tensor]:
    """Return (states (B, N, D), lengths (B, N)) -> Jacobians of steps (B, N, D, D), computed in `dtype`.

    Args:
        dynamics: dynamics with the parameters to use.
        dtype: type of the Jacobians.
    """
    return partial(jacobians_of_steps(dynamics, dtype), parameters_to_vector(dynamics.parameters()).detach())


def mapped_jacobians_of_steps(dynamics: Dynamics, dtype: torch.dtype = torch.float32) -> StepJacobians:
    """Return the Jacobians of steps for any dynamics, by vectorised reverse mode."""
    increment, own = parametrised(dynamics, dynamics.increment, dtype), dynamics.own_step

    def jacobians(theta: Tensor, states: Tensor, lengths: Tensor) -> Tensor:
        moved = partial(increment, theta.to(dtype))
        if own is not None:
            require_step(own, lengths)
            return step_jacobians(lambda x, _: moved(x, own), states.to(dtype), lengths.to(dtype))
        return step_jacobians(moved, states.to(dtype), lengths.to(dtype))

    return jacobians


def jacobian_along(function: Callable[[Tensor], Tensor], x: Tensor) -> Tensor:
    """Return df/dx, shape (B, M, D), at x, shape (B, D), of a function of states with variations."""
    one = torch.eye(x.shape[1]).to(x).expand(len(x), -1, -1)
    return function(torch.cat((x.unsqueeze(1), one), dim=1))[:, 1:].mT


def varied(field: nn.Module) -> VectorField | None:
    """Return the field of states with their variations, (B, 1 + D, D); None where it is unknown."""
    if isinstance(field, Forced):
        inner = varied(field.hamiltonian)
        return None if inner is None else ForcedVariations(field, inner)
    if not (isinstance(field, GenericHamiltonian | SeparableHamiltonian) and field.has_hessian):
        return None
    return GenericVariations(field) if isinstance(field, GenericHamiltonian) else SeparableVariations(field)


class GenericVariations:
    """(x, y_1 .. y_D) -> (f, f_x y_1 .. f_x y_D) for the field f of H(q, p)."""

    def __init__(self, field: GenericHamiltonian) -> None:
        self.energy = field

    def __call__(self, x: Tensor) -> Tensor:
        """Return the rates, shape (B, 1 + D, D), of states and variations."""
        of_q, of_p = _slope(self.energy, x).chunk(2, dim=-1)
        return torch.cat((of_p, -of_q), dim=-1)


class SeparableVariations:
    """Variational equations for H = T(p) + V(q)."""

    def __init__(self, field: SeparableHamiltonian) -> None:
        self.kinetic, self.potential = field.energies

    def velocity(self, p: Tensor) -> Tensor:
        """Return the rates of the positions, shape (B, 1 + D, n), from the momenta."""
        return _slope(self.kinetic, p)

    def force(self, q: Tensor) -> Tensor:
        """Return the rates of the momenta, shape (B, 1 + D, n), from the positions."""
        return -_slope(self.potential, q)

    def __call__(self, x: Tensor) -> Tensor:
        """Return the rates, shape (B, 1 + D, D), of states and variations."""
        q, p = x.chunk(2, dim=-1)
        return torch.cat((self.velocity(p), self.force(q)), dim=-1)


class ForcedVariations:
    """Variational equations for Hamilton's equations with forces."""

    def __init__(self, field: Forced, inner: VectorField) -> None:
        self.field, self.inner = field, inner

    def __call__(self, x: Tensor) -> Tensor:
        """Return the rates, shape (B, 1 + D, D), of extended states and variations."""
        q, c, p, rates = split(x, self.field.clock)
        v, pull = self.inner(torch.cat((q, p), dim=-1)).chunk(2, dim=-1)
        seen = Instant(c[..., :1], c[..., 1:], q, v)
        here, by = Instant(*(part[:, 0] for part in seen)), Instant(*(part[:, 1:] for part in seen))
        moved = sum(force.variation(here, by) for force in self.field.parts)
        force = torch.cat((total(self.field.parts, here).unsqueeze(1), cast(Tensor, moved)), dim=1)
        return torch.cat((v, rates, pull + force, torch.zeros_like(rates)), dim=-1)


@torch.no_grad()
def _slope(energy: Energy | GenericHamiltonian, x: Tensor) -> Tensor:
    """Return dE/dx at the first row and its variations along the other rows, shape of x, (B, 1 + D, n)."""
    gradient, hessian = energy.derivatives(x[:, 0])
    return torch.cat((gradient.unsqueeze(1), x[:, 1:] @ hessian), dim=1)

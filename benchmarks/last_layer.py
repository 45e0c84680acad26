"""Posterior of the last layer of a model trained on measurements, by Hamiltonian Monte Carlo.

The hidden layers keep their trained values. Unknown are the outputs' weights w and the initial states of the
trajectories, which are sampled, too, with flat priors: nothing is eliminated or linearised. The density is

    -2 log p = |residuals|^2 + sum alpha (w - prior mean)^2,

with the measurements, the noise and the prior strengths alpha of the training's last steps. If the last step
was taken in function space, the unknowns are the linear parameters of that step, as in the training.
Residuals follow from the integrator steps of the model, and the mass matrix is the Gauss-Newton matrix.

The training also limits the cost of trajectories that it does not explain; the posterior does not.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from ahnn.dynamics import Dynamics
from ahnn.dynamics.energies import NetworkEnergy
from ahnn.dynamics.fields import HamiltonianDynamics
from ahnn.dynamics.gradients import plain_gradient
from ahnn.dynamics.hamiltonians import SeparableHamiltonian
from ahnn.dynamics.layered import Network
from ahnn.dynamics.linearised import linearised
from ahnn.errors import UserError
from ahnn.measurements import Segment
from ahnn.runs import Run
from ahnn.shooting.path_sensitivities import path, steps_between
from ahnn.shooting.robust import ROBUST
from ahnn.training.maximum_posterior import whole_problem

REACH = 1e-5
"""Half-width of the central differences for the Gauss-Newton matrix, in the units of the variables."""


class Outputs(NamedTuple):
    """Weights of the last layers among the parameters of a run.

    Attributes:
        places: indices in the parameters of the run's dynamics, (W,).
        values: w, (W,), in the parameters in which the prior is defined.
        strengths: precision of their prior, (W,).
    """

    places: Tensor
    values: Tensor
    strengths: Tensor


def outputs_of(run: Run) -> Outputs:
    """Return the weights of the last layers of a run; raises UserError where it has no covariance."""
    known, dynamics = run.uncertainty, run.dynamics
    if known is None:
        message = "run: expected a training on measurements with a covariance; received one without"
        raise UserError(message)
    theta = parameters_to_vector(dynamics.parameters())
    places = torch.arange(len(theta))
    if known.before is not None and known.tangent is not None:
        dynamics, (_, known) = known.before, known.tangent
        assert known.step is not None
        found = linearised(dynamics, known.step)
        assert found is not None
        places, theta = found[1], parameters_to_vector(dynamics.parameters()) + known.step
    columns = last_layers(dynamics)
    sizes = torch.tensor([p.numel() for p in dynamics.parameters()])
    strengths = torch.tensor([known.about["strengths"][name] for name, _ in dynamics.named_parameters()])
    strengths = strengths.to(theta).repeat_interleave(sizes)
    return Outputs(places[columns], theta.detach()[columns], strengths[columns])


def last_layers(dynamics: Dynamics) -> Tensor:
    """Return the indices of the output weights and biases of all networks in the parameters."""
    owners = [name for name, module in dynamics.named_modules() if isinstance(module, Network)]
    found, begin = [], 0
    for name, parameter in dynamics.named_parameters():
        end = begin + parameter.numel()
        if any(name.startswith(f"{owner}.output.") for owner in owners):
            found.append(torch.arange(begin, end))
        begin = end
    return torch.cat(found)


class LastLayer:
    """Log posterior of standardised variables u: (w, starts) = centre + L u.

    Args:
        run: training on measurements with squared residuals, of T(p) + V(q) with a network for V.
        train: its training measurements.

    Raises:
        UserError: a run without a covariance, or one that does not explain all of its trajectories.
    """

    def __init__(self, run: Run, train: Segment) -> None:
        self.run, self.outputs, self.train = run, outputs_of(run), train
        problem = whole_problem(copy.deepcopy(run.dynamics), train, ROBUST["none"])
        if problem.lost:
            message = f"run: expected one that explains its trajectories; received {problem.lost} lost ones"
            raise UserError(message)
        self.steps = steps_between(train.times, train.instrument.longest)
        self._shape = problem.starts.shape
        begin = torch.cat((torch.zeros_like(self.outputs.values), problem.starts.flatten()))
        reach = REACH * torch.eye(len(begin), dtype=begin.dtype)
        design = (self.rows(begin + reach) - self.rows(begin - reach)).T / (2 * REACH)
        lower = torch.linalg.cholesky(design.T @ design)
        self.factor = torch.linalg.solve_triangular(lower, torch.eye(len(begin)).to(lower), upper=False).mT
        self.centre = begin - self.factor @ (self.factor.mT @ (design.T @ self.rows(begin[None])[0]))

    def rows(self, variables: Tensor) -> Tensor:
        """Return residuals and prior in standard deviations, (C, R), at (changes of w, starts), (C, P)."""
        moved, starts = variables.split([len(self.outputs.places), self._shape.numel()], dim=-1)
        count, batch = len(variables), self._shape[0]
        flow = _Flow(self.run.dynamics, self.outputs.places, moved.repeat_interleave(batch, dim=0))
        lengths = self.steps.lengths.repeat(count, 1)
        states = path(flow, starts.reshape(count * batch, -1), lengths)[:, self.steps.ends]
        train = self.train._replace(
            values=self.train.values.repeat(count, 1, 1), times=self.train.times.repeat(count, 1)
        )
        prior = self.outputs.strengths.sqrt() * (self.outputs.values + moved)
        return torch.cat((train.white_residuals(states).reshape(count, -1), prior), dim=-1)

    def density(self, u: Tensor) -> Tensor:
        """Return the logarithm of the posterior, (C,), at standardised variables (C, P)."""
        return -0.5 * self.rows(self.centre + u @ self.factor.mT).square().sum(-1)

    def runs(self, u: Tensor) -> list[Run]:
        """Return runs with the weights of draws u, (S, P), as points."""
        theta = parameters_to_vector(self.run.dynamics.parameters())
        found = []
        for moved in (self.centre + u @ self.factor.mT)[:, : len(self.outputs.places)]:
            dynamics = copy.deepcopy(self.run.dynamics)
            vector_to_parameters(theta.index_add(0, self.outputs.places, moved), dynamics.parameters())
            found.append(replace(self.run, dynamics=dynamics, uncertainty=None))
        return found


class _Flow:
    """Increments of rows whose last layers differ; a vectorised map over chains takes five times as long.

    Args:
        dynamics: dynamics of the run.
        places: indices of the output weights in their parameters, (W,).
        moved: changes of these for each row, (B, W).
    """

    def __init__(self, dynamics: Dynamics, places: Tensor, moved: Tensor) -> None:
        assert isinstance(dynamics, HamiltonianDynamics)
        assert isinstance(dynamics.field, SeparableHamiltonian)
        self.integrator = dynamics.integrator
        self.kinetic, potential = dynamics.field.energies
        assert isinstance(potential, NetworkEnergy)
        assert not potential.falloff
        self.potential, network = potential, potential.network
        flat = parameters_to_vector(dynamics.parameters()).expand(len(moved), -1)
        begin, _ = last_layers(dynamics).aminmax()
        last = flat.index_add(1, places, moved)[:, begin : begin + network.output.weight.numel()]
        self.layers, self.activation = network.layers()._replace(last=last), network.activation

    def __call__(self, x: Tensor, dt: Tensor) -> Tensor:
        """Return the increments of states (B, D) over dt, (B,)."""
        return self.integrator.increment(self.field, x, dt)

    def field(self, x: Tensor) -> Tensor:
        """Return (dH/dp, -dH/dq), (B, D), at states (B, D), row by row."""
        q, p = x.chunk(2, dim=-1)
        z, pullback = self.potential.inputs.linearised(q)
        force = -self.potential.unit * pullback(plain_gradient(z, self.layers, self.activation))
        return torch.cat((self.kinetic.gradient(p), force), dim=-1)

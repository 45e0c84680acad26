"""Lengths of a Gaussian process by evidence: the closed form, what is found, and what holds afterwards."""

from __future__ import annotations

import math

import torch
from helpers import close, generator
from oscillators import Swing, segment
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import make_dynamics
from ahnn.dynamics.derivatives import field_jacobian
from ahnn.measurements import State
from ahnn.shooting.robust import ROBUST
from ahnn.statistics import Statistics
from ahnn.training.length_scales import (
    Along,
    Posterior,
    choose_lengths,
    evidence,
    lengths_of,
    linear_in,
    search,
)
from ahnn.training.maximum_posterior import whole_problem
from ahnn.types import Trajectories

DOUBLE = {"dtype": torch.float64}


def test_evidence_is_that_of_measurements_with_the_covariance_of_process_and_noise():
    """Beside log N(y; 0, I + J J^T / alpha), whose covariance is formed in full."""
    jacobian = torch.randn(9, 4, generator=generator(0), **DOUBLE)
    y = torch.randn(9, generator=generator(1), **DOUBLE)
    waves = torch.ones(4, dtype=torch.bool)
    found, exact = [], []
    for alpha in (0.1, 1.0, 30.0):
        found.append(evidence(jacobian.T @ jacobian, jacobian.T @ y, waves, alpha))
        covariance = torch.eye(9, **DOUBLE) + jacobian @ jacobian.T / alpha
        normal = torch.distributions.MultivariateNormal(torch.zeros(9, **DOUBLE), covariance)
        exact.append(float(normal.log_prob(y)))
    constant = float(0.5 * y.square().sum()) + 4.5 * math.log(2 * math.pi)
    close(torch.tensor(found), torch.tensor(exact) + constant, 1e-6)
    assert evidence(-torch.eye(4, **DOUBLE), jacobian.T @ y, waves, 0.5) == -torch.inf


def near_a_spring(network):
    """Dynamics whose field is nearly that of p^2 / 2 + q^2 on noisy states of it, and these."""
    torch.manual_seed(0)
    truth = Swing(2.0, 0.0)
    starts, batch = segment(
        *(20, 20), measurement=State(1), sd=0.1, missing=0.0, dynamics=truth, longest=0.1, seed=3
    )
    options = {"dof": 1, "inertia": 1.0, "hamiltonian": "generic", "mu": None, "inputs": "cartesian"}
    options |= {"scaling": "minmax", "integrator": {"name": "rk4"}, "network": network}
    made = make_dynamics("hamiltonian", **options).double()
    made.fit(Statistics.of(Trajectories(batch.values, batch.times)))
    if network["activation"] == "fourier":
        theta, states = parameters_to_vector(made.parameters()).detach(), batch.values.flatten(0, 1)
        rows = field_jacobian(made, torch.float64)(theta, states)[..., 2:].flatten(0, 1)
        right = truth.field(states).detach().flatten()
        fitted = torch.linalg.lstsq(rows.mT @ rows + 1e-3 * torch.eye(rows.shape[1]), rows.mT @ right)
        made.field.network.output.weight.data.copy_(fitted.solution.unsqueeze(0))
    return made, batch, starts


WAVES = {"width": 16, "depth": 1, "activation": "fourier"}


@torch.no_grad()
def test_a_quadratic_energy_gets_long_lengths_and_is_right_outside_the_data():
    made, batch, starts = near_a_spring(WAVES)
    lengths = lengths_of(made)
    before = parameters_to_vector(made.parameters())[lengths].exp()
    choose_lengths(made, batch, ROBUST["none"])
    after = parameters_to_vector(made.parameters())[lengths].exp()
    assert bool((after > 2.0 * before).all())
    outside = 1.5 * starts
    right = Swing(2.0, 0.0).field(outside)
    assert float((made.field(outside) - right).norm() / right.norm()) < 0.05
    held = parameters_to_vector(made.parameters()).clone()
    rows = field_jacobian(made, torch.float64)(held, outside)
    assert float(rows[..., lengths].abs().max()) == 0.0  # no step of parameters moves lengths from now on
    assert float(rows[..., linear_in(made)].abs().max()) > 0.1


@torch.no_grad()
def test_weights_are_the_least_squares_of_measurements_and_prior():
    """One Gauss-Newton step of ridge regression, from the problem's own normal equations."""
    made, batch, _ = near_a_spring(WAVES)
    problem = whole_problem(made, batch, ROBUST["none"])
    here = parameters_to_vector(made.parameters())
    found = Along(problem, made).posterior(here)
    _, _, (block,) = problem.equations(here, [])
    own = linear_in(made)
    matrix, gradient = block.matrix[own][:, own], block.gradient[own]
    moved = found.theta[own] - here[own]
    # (A + alpha) w = A w0 - g for the alpha that was found
    left = matrix @ moved + gradient
    alpha = -float((left @ found.theta[own]) / found.theta[own].square().sum())
    assert alpha > 0
    close(left, -alpha * found.theta[own], 1e-3)


@torch.no_grad()
def test_networks_without_waves_stay_as_they_are():
    made, batch, _ = near_a_spring({"width": 4, "depth": 1, "activation": "tanh"})
    before = parameters_to_vector(made.parameters()).clone()
    choose_lengths(made, batch, ROBUST["none"])
    assert torch.equal(parameters_to_vector(made.parameters()), before)


def test_a_search_finds_the_top_of_a_hill_in_several_lengths():
    """Of -sum (log l - m)^2, to within the finest factor; parameters that are no lengths are not tried."""
    middle, lengths = torch.tensor([0.0, 1.3, -0.8], **DOUBLE), torch.tensor([False, True, True])

    def hill(theta):
        assert float(theta[0]) == 7.0
        return Posterior(-100 * float((theta - middle)[lengths].square().sum()), theta)

    found = search(hill, torch.tensor([7.0, 0.0, 0.0], **DOUBLE), lengths)
    assert float((found.theta - middle)[lengths].abs().max()) < math.log(1.4)

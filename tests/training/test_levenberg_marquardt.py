"""Levenberg-Marquardt solves linear problems at once, never raises a batch's loss, and fits to round-off."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import pytest
import torch
from helpers import MOLNIYA, batch_of, close, data_module, generator, ready_model
from torch import nn

from ahnn.dynamics.networks import Perceptron
from ahnn.errors import UserError
from ahnn.training import LevenbergMarquardt, pointwise_problem
from ahnn.training.normal_equations import Equations


class Rosenbrock(nn.Module):
    """Residuals (10 (b - a^2), 1 - a), the standard narrow valley; minimum 0 at (1, 1)."""

    def __init__(self):
        super().__init__()
        self.x = nn.Parameter(torch.tensor([-1.2, 1.0], dtype=torch.float64))

    def forward(self, one):
        a, b = self.x
        return one * torch.stack((10 * (b - a * a), 1 - a))


def pointwise(module, x, y):
    return pointwise_problem(module, module.forward, x, y, torch.ones_like(y))


def fit(module, x, y, steps, **options):
    """Step on one problem, the same held back, and return the losses before each step and after the last."""
    optimizer = LevenbergMarquardt(module.parameters(), **options)
    problem = pointwise(module, x, y)
    losses = [float(optimizer.step(lambda: (problem, problem))) for _ in range(steps)]
    return [*losses, float((module(x) - y).detach().square().mean())]


def test_a_linear_problem_is_solved_in_two_steps():
    rng = generator(0)
    x = torch.randn(50, 4, generator=rng, dtype=torch.float64)
    y = torch.randn(50, 1, generator=rng, dtype=torch.float64)
    line = nn.Linear(4, 1).double()
    losses = fit(line, x, y, 2, damping=1e-8)
    exact = torch.linalg.lstsq(torch.cat((x, torch.ones(50, 1)), 1), y).solution
    best = float((torch.cat((x, torch.ones(50, 1)), 1) @ exact - y).square().mean())
    assert losses[-1] == pytest.approx(best, rel=1e-12)
    close(
        torch.cat((line.weight.flatten(), line.bias)), exact.flatten(), 1e-6
    )  # J has the eps of float32, 1.2e-7


@pytest.mark.parametrize("name", ["generic", "separable", "node", "mlp", "hnn_derivative", "central_body"])
@pytest.mark.parametrize("window", [2, 4])
def test_the_jacobian_is_autograds(cache, name, window):
    data = data_module(MOLNIYA, cache, window=window)
    batch = batch_of(data, 3)
    model = ready_model(name, data)
    problem = model.objective.problem(model.dynamics, batch)
    parameters = list(model.dynamics.parameters())
    theta = nn.utils.parameters_to_vector(parameters).detach()
    flat = model.objective.residuals(model.dynamics, batch).flatten()
    rows = []
    for r in flat:
        grads = torch.autograd.grad(
            r, parameters, retain_graph=True, allow_unused=True, materialize_grads=True
        )
        rows.append(torch.cat([g.flatten() for g in grads]))
    close(problem.residuals(theta), flat, 1e-14)
    assert problem.jacobian(theta).dtype is torch.float32
    close(problem.jacobian(theta).double(), torch.stack(rows), 1e-5)


def test_the_valley_of_rosenbrock_is_followed_to_its_end():
    module, one = Rosenbrock(), torch.ones(1, 1, dtype=torch.float64)
    losses = fit(module, one, torch.zeros(1, 2, dtype=torch.float64), 60)
    assert losses[-1] < 1e-20
    close(module.x, torch.ones(2), 1e-9)


def test_a_small_network_fits_a_sine_to_round_off_and_never_raises_its_loss():
    torch.manual_seed(3)
    network = Perceptron(1, 1, width=12, depth=1, activation="tanh").double()
    x = torch.linspace(-1, 1, 60, dtype=torch.float64).unsqueeze(-1)
    losses = fit(network, x, torch.sin(3 * x + 0.5), 100)
    assert losses[-1] < 1e-8
    assert all(after <= before for before, after in pairwise(losses))


def test_a_step_that_spoils_the_windows_held_back_is_not_taken():
    line = nn.Linear(1, 1, bias=False).double()
    with torch.no_grad():
        line.weight.fill_(1.0)
    one = torch.ones(4, 1, dtype=torch.float64)
    main, against = pointwise(line, one, 3 * one), pointwise(line, one, 0.999 * one)
    LevenbergMarquardt(line.parameters(), tolerance=1e-3).step(lambda: (main, against))
    assert float(line.weight.detach()) == pytest.approx(1.0, abs=1e-4)


def test_a_non_finite_problem_changes_no_weight():
    line = nn.Linear(1, 1).double()
    before = nn.utils.parameters_to_vector(line.parameters()).detach().clone()
    x = torch.full((4, 1), torch.nan, dtype=torch.float64)
    losses = fit(line, x, torch.zeros_like(x), 2)
    assert not losses[0] < 1e300
    assert torch.equal(nn.utils.parameters_to_vector(line.parameters()), before)


@pytest.mark.parametrize("options", [{"damping": 0.0}, {"tolerance": -1.0}])
def test_impossible_settings_are_refused_by_name(options):
    ((name, value),) = options.items()
    with pytest.raises(UserError, match=f"^{name}: expected float > 0; received {value}"):
        LevenbergMarquardt([nn.Parameter(torch.zeros(1))], **options)


def test_a_problem_of_a_whole_module_leaves_its_parameters_in_place():
    line = nn.Linear(2, 2).double()
    before, x = list(line.parameters()), torch.eye(2, dtype=torch.float64)
    problem = pointwise_problem(line, line, x, x, torch.ones_like(x))
    LevenbergMarquardt(line.parameters()).step(lambda: (problem, None))
    assert all(
        p is q and p.is_leaf and p.requires_grad for p, q in zip(line.parameters(), before, strict=True)
    )


def test_where_nothing_depends_on_the_parameters_the_mean_square_is_returned():
    theta = nn.Parameter(torch.ones(2, dtype=torch.float64))
    problem = SimpleNamespace(equations=lambda *_: Equations(torch.tensor(6.0), 3, []))
    assert float(LevenbergMarquardt([theta]).step(lambda: (problem, None))) == 2.0
    assert theta.tolist() == [1.0, 1.0]

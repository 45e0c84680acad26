"""How the damping of Levenberg-Marquardt follows the gain of its steps, and what a step reports."""

from __future__ import annotations

import math

import pytest
import torch
from helpers import generator
from torch import nn

from ahnn.training import LevenbergMarquardt, pointwise_problem
from ahnn.training.least_squares import LeastSquares
from ahnn.training.levenberg_marquardt import ATTEMPTS, adapted


@pytest.mark.parametrize(
    ("gain", "rise", "accepted", "factor"),
    [
        (0.9, -0.1, True, 1 / 3),
        (0.76, 0.0, True, 1 / 3),
        (0.75, -0.1, True, 1.0),
        (0.26, -0.1, True, 1.0),
        (0.25, -0.1, True, 3.0),
        (0.01, 0.0, True, 3.0),
        (0.9, 0.1, True, 2 / 3),
        (0.5, 1e-9, True, 2.0),
        (0.1, 0.2, True, 6.0),
        (0.9, 0.5, False, 4.0),
        (-1.0, -0.5, False, 4.0),
        (math.nan, math.nan, False, 4.0),
    ],
)
def test_the_damping_falls_with_a_good_gain_and_rises_with_a_bad_one(gain, rise, accepted, factor):
    assert adapted(1e-2, gain, rise, accepted) == pytest.approx(factor * 1e-2, rel=1e-14)


def test_the_damping_stays_in_its_range():
    assert adapted(1e-14, 0.9, -0.1, True) == 1e-14
    assert adapted(1e6, 0.0, 0.0, False) == 1e6
    assert adapted(3e5, 0.0, 0.0, False) == 1e6


def line_problem(seed=0):
    """A linear module with its problem, and the residuals as a function of the module."""
    rng = generator(seed)
    torch.manual_seed(seed)
    line = nn.Linear(3, 2).double()
    x, y = (torch.randn(20, n, generator=rng, dtype=torch.float64) for n in (3, 2))
    return line, pointwise_problem(line, line.forward, x, y, torch.ones_like(y)), x, y


def test_a_step_reports_the_gradient_norm_of_the_mean_square():
    line, problem, x, y = line_problem()
    gradients = torch.autograd.grad((line(x) - y).square().mean(), list(line.parameters()))
    exact = float(torch.cat([g.flatten() for g in gradients]).norm())
    optimizer = LevenbergMarquardt(line.parameters())
    optimizer.step(lambda: (problem, problem))
    assert optimizer.param_groups[0]["gradient_norm"] == pytest.approx(exact, rel=1e-5)  # J is float32
    assert optimizer.param_groups[0]["damping"] == pytest.approx(1e-2 / 3, rel=1e-12)


class Counted:
    """A problem in one parameter whose residuals are a function of it; it counts its evaluations."""

    def __init__(self, function, slope):
        self.function, self.slope, self.calls = function, slope, 0

    def residuals(self, theta):
        self.calls += 1
        return self.function(theta)

    def problem(self):
        return LeastSquares(self.residuals, lambda _: torch.tensor([[self.slope]]))


@pytest.mark.parametrize("slope", [1.0, -1.0])
def test_a_step_that_brings_nothing_is_tried_with_six_dampings_and_not_taken(slope):
    parameter = nn.Parameter(torch.ones(1, dtype=torch.float64))
    made = Counted(lambda theta: 1.0 + 0.0 * theta, slope)  # the Jacobian promises what never comes
    optimizer = LevenbergMarquardt([parameter], damping=1e-2)
    loss = optimizer.step(lambda: (made.problem(), made.problem()))
    assert float(loss) == pytest.approx(1.0)
    assert float(parameter.detach()) == 1.0
    assert optimizer.param_groups[0]["damping"] == pytest.approx(1e-2 * 4.0**6, rel=1e-12)
    assert ATTEMPTS == 6
    assert made.calls == 1 + 6  # nobody asks what the windows held back would say


@pytest.mark.parametrize(("held", "taken"), [(1.29, True), (1.31, False)])
def test_the_held_back_loss_may_rise_by_the_tolerance(held, taken):
    parameter = nn.Parameter(torch.ones(1, dtype=torch.float64))
    main = Counted(lambda theta: theta, 1.0)
    against = Counted(lambda theta: torch.where(theta < 0.9, held**0.5, 1.0) + 0 * theta, 0.0)
    optimizer = LevenbergMarquardt([parameter], damping=1e-2, tolerance=0.3)
    optimizer.step(lambda: (main.problem(), against.problem()))
    damping = optimizer.param_groups[0]["damping"]
    assert (float(parameter.detach()) < 0.5) == taken
    assert damping == pytest.approx(1e-2 * 2 / 3, rel=1e-12) if taken else damping > 1.0


def test_a_problem_that_no_factor_exists_for_raises_the_damping_tenfold():
    parameter = nn.Parameter(torch.ones(1, dtype=torch.float64))
    broken = LeastSquares(lambda theta: theta, lambda _: torch.tensor([[math.nan]]))
    optimizer = LevenbergMarquardt([parameter], damping=1e-2)
    optimizer.step(lambda: (broken, broken))
    assert optimizer.param_groups[0]["damping"] == pytest.approx(1e4, rel=1e-12)
    for _ in range(2):
        optimizer.step(lambda: (broken, broken))
    assert optimizer.param_groups[0]["damping"] == 1e6
    assert float(parameter.detach()) == 1.0


class Bending:
    """Linear residuals, whose bend is far too large for so many steps, and nothing after them."""

    def __init__(self, too_large):
        plain = LeastSquares(lambda theta: 4 * theta, lambda _: torch.tensor([[4.0]]))
        self.loss, self.equations, self.left = plain.loss, plain.equations, too_large

    def bend(self, theta, step, reach):
        del step, reach
        self.left -= 1
        return torch.full_like(theta, 1e9 if self.left >= 0 else 0.0)


@pytest.mark.parametrize(
    ("too_large", "damping"), [(0, 1e-3 / 3), (1, 1e-3), (3, 9e-3), (6, 0.729), (9, 0.729)]
)
def test_a_step_that_bends_too_much_is_tried_again_with_three_times_the_damping(too_large, damping):
    parameter = nn.Parameter(torch.ones(1, dtype=torch.float64))
    optimizer = LevenbergMarquardt([parameter], damping=1e-3, acceleration=True)
    optimizer.step(lambda: (Bending(too_large), None))
    assert optimizer.param_groups[0]["damping"] == pytest.approx(damping, rel=1e-12)
    assert (float(parameter.detach()) == 1.0) == (too_large >= 6)
    optimizer.param_groups[0]["damping"] = 9e5
    optimizer.step(lambda: (Bending(9), None))
    assert optimizer.param_groups[0]["damping"] == 1e6

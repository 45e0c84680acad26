"""Geodesic acceleration, on the valley of Rosenbrock's function made narrow."""

from __future__ import annotations

import pytest
import torch
from helpers import close
from oscillators import DOUBLE
from torch import nn

from ahnn.training import LevenbergMarquardt
from ahnn.training.acceleration import accelerated
from ahnn.training.normal_equations import Block, Equations, damped_step, metric

STEEP = 1000.0


class Valley:
    """The residuals 1 - x and STEEP (y - x^2)."""

    def residuals(self, theta):
        return torch.stack((1 - theta[0], STEEP * (theta[1] - theta[0] ** 2)))

    def jacobian(self, theta):
        zero = torch.zeros_like(theta[0])
        return torch.stack((torch.stack((zero - 1, zero)), STEEP * torch.stack((-2 * theta[0], zero + 1))))

    def loss(self, theta):
        return self.residuals(theta).square().sum()

    def equations(self, theta, sizes):
        del sizes
        r, j = self.residuals(theta), self.jacobian(theta)
        return Equations(r.square().sum(), 2, [Block(torch.arange(2), j.T @ j, j.T @ r)])

    def bend(self, theta, step, reach):
        del reach
        return self.jacobian(theta).T @ torch.stack((torch.zeros_like(step[0]), -2 * STEEP * step[0] ** 2))


def steps_through(acceleration):
    theta = nn.Parameter(torch.tensor([-1.0, 1.0], dtype=torch.float64))
    optimizer = LevenbergMarquardt([theta], damping=1e-3, acceleration=acceleration)
    for number in range(400):
        if float(optimizer.step(lambda: (Valley(), None))) < 1e-20:
            return number
    return 400


def test_it_goes_along_the_valley_in_far_fewer_steps():
    straight, following = steps_through(False), steps_through(True)
    assert following < 0.5 * straight < 200


def test_it_stays_in_the_valley_to_second_order():
    """An undamped step from a point of the valley leaves it by its square; a bent one by its cube."""
    theta = torch.tensor([0.5, 0.25], dtype=torch.float64)
    _, _, blocks = Valley().equations(theta, [2])
    straight = damped_step(blocks, 1e-12, theta)
    short = 0.5 * straight
    moved = accelerated(Valley(), theta, blocks, short, 1e-12)
    close(moved[1] + theta[1], (theta[0] + moved[0]) ** 2, 1e-6)
    assert abs(float(Valley().residuals(theta + short)[1])) > 10


def test_a_step_that_bends_too_much_is_not_taken():
    theta = torch.tensor([0.5, 0.25], dtype=torch.float64)
    _, _, blocks = Valley().equations(theta, [2])
    assert accelerated(Valley(), theta, blocks, torch.tensor([3.0, 3.0], dtype=torch.float64), 1.0) is None


@pytest.mark.parametrize("split", [False, True])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("share", "taken"), [(0.7, True), (0.8, False)])
def test_three_quarters_of_the_step_are_the_most_that_a_bend_may_ask_for(share, taken, axis, split):
    """Lengths are in units of sqrt(J^T J), by which the two parameters differ a hundredfold."""
    squares = torch.tensor([1e4, 1.0], **DOUBLE)
    parts = [torch.tensor([0]), torch.tensor([1])] if split else [torch.arange(2)]
    blocks = [Block(part, torch.diag(squares[part]), 0 * squares[part]) for part in parts]
    diagonal = torch.cat([metric(block) for block in blocks])
    step = torch.tensor([1.0, 0.0], **DOUBLE)
    turn = torch.zeros(2, **DOUBLE)
    turn[axis] = share * (diagonal[0] / diagonal[axis]).sqrt()
    problem = Valley()
    problem.bend = lambda *_: -squares * turn
    moved = accelerated(problem, step, blocks, step, 0.0)
    if taken:
        close(moved, step + turn / 2, 1e-9)
    else:
        assert moved is None


def test_a_bend_that_is_not_finite_bends_nothing():
    theta = torch.tensor([0.5, 0.25], dtype=torch.float64)
    _, _, blocks = Valley().equations(theta, [2])
    lost = Valley()
    lost.bend = lambda theta, *_: torch.full_like(theta, torch.nan)
    assert accelerated(lost, theta, blocks, damped_step(blocks, 1e-12, theta), 1e-12) is None

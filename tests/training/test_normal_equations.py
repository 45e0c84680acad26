"""The normal equations in blocks are those of the whole Jacobian, whatever its zeros."""

from __future__ import annotations

import torch
from helpers import close, generator
from hypothesis import given
from hypothesis import strategies as st

from ahnn.training.normal_equations import (
    TOGETHER,
    damped_step,
    independent,
    memory_of_parts,
    normal_equations,
    promised_decrease,
)

SIZES = [3, 1, 4, 2]


def patterned(seed, patterns):
    """Return a Jacobian whose rows use the parameter tensors of a pattern each, and residuals, in float64."""
    rng = generator(seed)
    jacobian = torch.randn(60, sum(SIZES), generator=rng, dtype=torch.float64)
    used = torch.tensor(patterns)[torch.randint(len(patterns), (60,), generator=rng)]
    jacobian *= used.repeat_interleave(torch.tensor(SIZES), dim=1)
    return jacobian, torch.randn(60, generator=rng, dtype=torch.float64)


@given(
    seed=st.integers(0, 10**6),
    patterns=st.lists(st.lists(st.booleans(), min_size=4, max_size=4), min_size=1, max_size=4),
)
def test_blocks_solve_the_whole_system_and_promise_its_decrease(seed, patterns):
    jacobian, residuals = patterned(seed, patterns)
    theta = torch.zeros(sum(SIZES), dtype=torch.float64)
    blocks = normal_equations(jacobian, residuals, SIZES)
    step = damped_step(blocks, 1e-3, theta)
    whole = jacobian.T @ jacobian
    damping = torch.zeros_like(theta)
    for block in blocks:
        diagonal = whole.diagonal()[block.columns]
        damping[block.columns] = 1e-3 * (diagonal + 1e-3 * diagonal.mean())
    idle = whole.diagonal() == 0
    exact = torch.linalg.solve(whole + torch.diag(damping + idle), -jacobian.T @ residuals)
    close(step, exact, 1e-9)
    decrease = residuals.square().sum() - (residuals + jacobian @ step).square().sum()
    close(promised_decrease(blocks, step), decrease, 1e-9)


def test_tensors_that_share_no_row_are_solved_apart_and_unused_ones_not_at_all():
    used = torch.tensor([[1, 1, 0, 0, 0], [0, 0, 1, 0, 0], [0, 1, 0, 1, 0]], dtype=torch.bool)
    sets = {tuple(row) for row in independent(used).int().tolist()}
    assert sets == {(1, 1, 0, 1, 0), (0, 0, 1, 0, 0)}


def test_no_residual_depends_on_anything():
    theta = torch.ones(3, dtype=torch.float64)
    blocks = normal_equations(torch.zeros(4, 3), torch.ones(4, dtype=torch.float64), [2, 1])
    step = damped_step(blocks, 1.0, theta)
    assert blocks == []
    assert torch.equal(step, torch.zeros_like(theta))
    assert float(promised_decrease(blocks, step)) == 0.0


def test_parts_take_a_matrix_each_beside_that_of_their_sum():
    assert memory_of_parts(70) == (TOGETHER + 1) * torch.zeros(70, 70, dtype=torch.float64).nbytes

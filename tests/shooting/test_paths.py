"""Paths and their derivatives, held against exponentials of matrices and central differences."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch
from helpers import close, generator

from ahnn.jacobians import pointwise_jacobian, step_jacobians
from ahnn.shooting.path_sensitivities import (
    Steps,
    adjoints,
    path,
    sensitivities,
    steps_between,
    transitions,
)

A = torch.tensor([[0.1, 1.0], [-2.0, -0.3]], dtype=torch.float64)


def exact(x, dt):
    """Increment of dx/dt = A x."""
    return (torch.linalg.matrix_exp(A * dt[:, None, None]) @ x.unsqueeze(-1)).squeeze(-1) - x


def lengths(rows=3, steps=7):
    return 0.05 + 0.2 * torch.rand(rows, steps, generator=generator(0), dtype=torch.float64)


def starts(rows=3):
    return torch.randn(rows, 2, generator=generator(1), dtype=torch.float64)


def test_a_linear_path_and_its_transitions_are_exponentials():
    dt, x = lengths(), starts()
    states = path(exact, x, dt)
    elapsed = torch.cat((torch.zeros(3, 1), dt.cumsum(1)), dim=1)
    expected = torch.linalg.matrix_exp(A * elapsed[..., None, None])
    close(states, (expected @ x[:, None, :, None]).squeeze(-1), 1e-13)
    close(transitions(step_jacobians(exact, states[:, :-1], dt)), expected, 1e-13)


def test_jacobians_of_a_nonlinear_step_are_central_differences():
    move = lambda x, dt: dt[:, None] * torch.stack((x[:, 1], -x[:, 0].sin()), -1)  # noqa: E731
    x, dt, e = starts(), lengths(steps=1), 1e-6
    got = step_jacobians(move, x.unsqueeze(1), dt)[:, 0]
    for j in range(2):
        shift = e * torch.eye(2, dtype=torch.float64)[j]
        numeric = (move(x + shift, dt[:, 0]) - move(x - shift, dt[:, 0])) / (2 * e) + shift / e
        close(got[..., j], numeric, 1e-9)


def test_a_function_that_does_not_depend_on_its_argument_has_no_slope():
    x = starts()
    close(pointwise_jacobian(lambda _: torch.ones(3, 4, dtype=torch.float64), x), torch.zeros(3, 4, 2), 0)


@pytest.mark.parametrize("parts", [1, 2])
def test_steps_end_on_every_time_and_none_is_too_long(parts):
    times = torch.tensor([[0.0, 0.1, 0.5, 1.2], [3.0, 3.05, 3.6, 4.0]], dtype=torch.float64)
    steps = steps_between(times, 0.4 / parts)
    assert float(steps.lengths.max()) <= 0.4 / parts + 1e-12
    elapsed = torch.cat((torch.zeros(2, 1), steps.lengths.cumsum(1)), dim=1)
    close(elapsed[:, steps.ends], times - times[:, :1], 1e-14)
    assert steps.ends.tolist() == [0, 1, 3, 5] if parts == 1 else [0, 1, 4, 8]
    close(steps.first(2).lengths, steps.lengths[:, : int(steps.ends[2])], 0)


def test_a_step_that_rounds_above_the_longest_is_still_one():
    steps = steps_between(torch.tensor([[0.0, 60.000000000000007, 120.0]], dtype=torch.float64), 60.0)
    assert steps.ends.tolist() == [0, 1, 2]


def test_two_halves_are_two_steps_that_end_where_one_did():
    dt = lengths()
    steps = Steps(dt, torch.tensor([0, 2, 7]))
    halves = steps.halved()
    close(halves.lengths[:, ::2], dt / 2, 0)
    close(halves.lengths[:, 1::2], dt / 2, 0)
    close(
        path(exact, starts(), halves.lengths)[:, halves.ends], path(exact, starts(), dt)[:, steps.ends], 1e-13
    )


@pytest.mark.parametrize(("quartered", "order"), [(False, 2), (True, 4)])
def test_sensitivities_converge_with_the_order_of_their_rule(quartered, order):
    """dx/dt = A x + theta t^0: dx/dtheta is the integral of an exponential, A^-1 (e^At - 1)."""
    errors = []
    for count in (4, 8, 16):
        times = torch.tensor([[0.0, 1.0]], dtype=torch.float64)
        whole = steps_between(times, 1.0 / count)
        steps = whole.quarters() if quartered else whole
        number = 4 * count if quartered else count
        assert steps.lengths.shape == (1, number)
        jacobian = torch.linalg.matrix_exp(A / number).expand(1, number, 2, 2)
        forcing = torch.eye(2, dtype=torch.float64).expand(1, number + 1, 2, 2)
        got = sensitivities(jacobian, forcing, steps)[:, -1]
        expected = torch.linalg.solve(A, torch.linalg.matrix_exp(A) - torch.eye(2))
        errors.append(float((got[0] - expected).abs().max()))
    for coarse, fine in pairwise(errors):
        assert coarse / fine == pytest.approx(2**order, rel=0.1)


@pytest.mark.parametrize("quartered", [False, True])
def test_adjoints_are_the_transpose_of_sensitivities(quartered):
    """Sum pulls_k S_k v = sum c_k f_theta(x_k) v, for any pulls and any forcing."""
    jacobians, forcing = (
        torch.randn(3, n, 2, 2, generator=generator(n), dtype=torch.float64) for n in (8, 9)
    )
    pulls = torch.randn(3, 3, 2, generator=generator(9), dtype=torch.float64)
    steps = Steps(lengths(steps=8), torch.tensor([0, 4, 8]), quartered)
    forward = torch.einsum("bkd,bkdp->p", pulls, sensitivities(jacobians, forcing, steps))
    backward = torch.einsum("bnd,bndp->p", adjoints(jacobians, pulls, steps), forcing)
    close(backward, forward, 1e-12)

"""Normal points: fewer rows, the same normal equations."""

from __future__ import annotations

import torch
from helpers import close, generator

from ahnn.shooting.initial_states import Linearised
from ahnn.shooting.normal_points import POINTS, normal_points
from ahnn.shooting.path_sensitivities import Steps, sensitivities, transitions

SEGMENTS, ROWS, SIZE, PARAMETERS = 3, 9, 6, 4
F64 = torch.float64


def linear(times, seen, rows=ROWS, every=1):
    """Return residuals at many times that depend on some components of a state, and these states."""
    draw = generator(3)
    steps = every * (times - 1)
    jacobians = 0.3 * torch.randn(SEGMENTS, steps, SIZE, SIZE, generator=draw, dtype=F64)
    jacobians = torch.linalg.matrix_exp(jacobians)
    jacobians = jacobians / torch.linalg.det(jacobians).abs()[..., None, None] ** (1 / SIZE)
    ends = torch.arange(times) * every
    of_state = torch.randn(SEGMENTS, times, rows, SIZE, generator=draw, dtype=F64)
    of_state[..., seen:] = 0
    of_state[0, 2] = 0  # not measured
    residuals = torch.randn(SEGMENTS, times, rows, generator=draw, dtype=F64)
    residuals[0, 2] = 0
    return Linearised(jacobians, residuals, of_state, of_state @ transitions(jacobians)[:, ends]), ends


def equations(now, ends, forcing):
    """Return the matrix and the right side of the normal equations in starts and parameters."""
    lengths = now.residuals.new_full(now.jacobians.shape[:2], 0.1)
    moved = sensitivities(now.jacobians, forcing, Steps(lengths, ends))
    rows = torch.cat((now.of_start, now.of_state @ moved), dim=-1).flatten(1, 2)
    return rows.mT @ rows, rows.mT @ now.residuals.flatten(1).unsqueeze(-1)


def kicks(now, at):
    """Return a forcing that acts at some states of the path alone."""
    forcing = now.residuals.new_zeros(SEGMENTS, now.jacobians.shape[1] + 1, SIZE, PARAMETERS)
    forcing[:, at] = torch.randn(SEGMENTS, len(at), SIZE, PARAMETERS, generator=generator(4), dtype=F64)
    return forcing


def test_many_sensors_of_a_time_become_the_components_that_they_see():
    plain, ends = linear(5, seen=3)
    few, same = normal_points(plain, ends)
    assert few.residuals.shape == (SEGMENTS, 5, 3)
    assert same.equal(ends)
    forcing = kicks(plain, [0, 1, 2, 3, 4])
    for mine, exact in zip(equations(few, same, forcing), equations(plain, ends, forcing), strict=True):
        close(mine, exact, 1e-12)


def test_residuals_that_see_as_many_components_as_they_have_rows_stay():
    plain, ends = linear(5, seen=6, rows=6)
    assert normal_points(plain, ends) == (plain, ends)
    twice, ends = linear(2 * POINTS, seen=6, rows=3)
    assert normal_points(twice, ends) == (twice, ends)  # two times three rows are six


def test_neighbouring_times_become_one_where_parameters_act_between_groups():
    times = 3 * POINTS + 1  # the last group holds one time
    plain, ends = linear(times, seen=6, rows=6, every=2)
    # Parameters kick in the midst of two steps between two groups: neither end of it is measured.
    between = [6 * k - 1 for k in (1, 5, 60)]
    few, middles = normal_points(plain, ends)
    assert few.residuals.shape == (SEGMENTS, POINTS + 1, 6)
    assert middles.tolist() == [*(6 * g + 2 for g in range(POINTS)), 2 * (times - 1)]
    forcing = kicks(plain, between)
    for mine, exact in zip(equations(few, middles, forcing), equations(plain, ends, forcing), strict=True):
        close(mine, exact, 1e-8)


def test_what_parameters_do_within_a_group_hardly_counts():
    """A constant force on a free particle: q moves by t²/2, of which a group neglects (τ/2)²/2 at most."""
    times, dt = 5 * POINTS + 1, 0.01
    step = torch.tensor([[1.0, dt], [0.0, 1.0]], dtype=F64)
    jacobians = step.expand(1, times - 1, 2, 2)
    ends = torch.arange(times)
    of_state = torch.eye(2, dtype=F64).expand(1, times, 2, 2)
    residuals = torch.randn(1, times, 2, generator=generator(5), dtype=F64)
    plain = Linearised(jacobians, residuals, of_state, of_state @ transitions(jacobians))
    few, middles = normal_points(plain, ends)
    assert len(middles) == POINTS + 1

    def information(now, at):
        steps = Steps(torch.full((1, times - 1), dt, dtype=F64), at)
        force = torch.ones(1, times, 1, 1, dtype=F64)  # of the momentum alone
        rows = (now.of_state @ sensitivities(now.jacobians, force, steps)).flatten(1, 2)
        basis = torch.linalg.qr(now.of_start.flatten(1, 2)).Q
        rows = rows - basis @ (basis.mT @ rows)
        return (rows.mT @ rows).squeeze()

    assert abs(information(few, middles) / information(plain, ends) - 1) < 1e-4

"""What a start does not undo of the parameters keeps its digits over many steps of an orbit."""

from __future__ import annotations

import copy

import pytest
import torch
from helpers import generator
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import make_dynamics
from ahnn.dynamics.derivatives import field_jacobian
from ahnn.dynamics.linearised import linearised
from ahnn.jacobians import step_jacobians
from ahnn.measurements import Instrument, Position, Segment
from ahnn.shooting.path_sensitivities import path, sensitivities, steps_between, transitions
from ahnn.shooting.robust import ROBUST
from ahnn.training.limited_segments import freedom
from ahnn.training.maximum_posterior import WideProblem, of_functions

NETWORK = {"width": 6, "depth": 2, "activation": "tanh"}
SD = 0.1  # km


def satellite(method="rk4", longest=60.0, rows=289):
    """A point mass and a small network, over a day of a Molniya orbit, positions every five minutes."""
    torch.manual_seed(0)
    options = {"hamiltonian": "central_body", "mu": None, "inputs": "isotropic", "scaling": "block"}
    options |= {"network": NETWORK, "integrator": {"name": method}, "inertia": 1.0}
    dynamics = make_dynamics("hamiltonian", dof=3, **options).double()
    potential = dynamics.field.potential
    potential.log_mu.data.fill_(398600.0).log_()
    potential.remainder.unit.fill_(0.03)
    potential.remainder.inputs.middle.fill_(10.0)
    start = torch.tensor([[3500.0, 2000.0, -5600.0, -5.0, 8.6, 0.0]], dtype=torch.float64)
    times = 300.0 * torch.arange(rows, dtype=torch.float64).unsqueeze(0)
    steps = steps_between(times, longest)
    with torch.no_grad():
        places = path(dynamics.increment, start, steps.lengths)[:, steps.ends, :3]
    noise = SD * torch.randn(places.shape, generator=generator(0), dtype=torch.float64)
    deviations = torch.full((3,), SD, dtype=torch.float64)
    return dynamics, Segment(places + noise, times, Instrument(Position(3), deviations, longest, 3, 1.0))


def test_a_start_of_six_components_takes_six_degrees_of_freedom():
    instrument = Instrument(Position(3), torch.ones(3, dtype=torch.float64), 1.0, 3, 1.0)
    values = torch.zeros(2, 5, 3, dtype=torch.float64)
    values[1, 2:] = torch.nan
    segment = Segment(values, torch.arange(5.0).expand(2, 5), instrument)
    assert freedom(segment).tolist() == [9, 0]


@pytest.mark.slow
@torch.no_grad()
def test_normal_equations_are_right_where_parameters_are_hard_to_see():
    dynamics, batch = satellite()
    theta = parameters_to_vector(dynamics.parameters())
    problem = WideProblem(dynamics, batch, ROBUST["none"])
    _, _, (block,) = problem.equations(theta, [p.numel() for p in dynamics.parameters()])
    wide, steps = copy.deepcopy(dynamics).requires_grad_(False), problem.steps
    states = path(wide.increment, problem.starts, steps.lengths)
    jacobians = step_jacobians(wide.increment, states[:, :-1], steps.lengths)
    moved = sensitivities(jacobians, field_jacobian(wide, torch.float64)(theta, states), steps)
    of_start = transitions(jacobians)[:, steps.ends, :3].flatten(1, 2)[0] / SD
    basis, of_theta = torch.linalg.qr(of_start).Q, moved[:, :, :3].flatten(1, 2)[0] / SD
    exact = of_theta - basis @ (basis.T @ of_theta)
    values, directions = torch.linalg.eigh(exact.T @ exact)
    seen = values > 1e-8 * values[-1]
    found = ((block.matrix @ directions) * directions).sum(0)
    assert int(seen.sum()) >= 4
    assert float((found / values - 1)[seen].abs().max()) < 5e-5  # float32 would leave 6e-4


@pytest.mark.slow
@torch.no_grad()
def test_a_step_of_dopri8_between_measurements_five_minutes_apart_is_short_enough():
    found = []
    for longest in (300.0, 60.0):
        dynamics, batch = satellite("dopri8", longest, rows=151)  # beyond a perigee
        theta = parameters_to_vector(dynamics.parameters())
        problem = WideProblem(dynamics, batch, ROBUST["none"])
        found.append(problem.equations(theta, [p.numel() for p in dynamics.parameters()]))
    (loss, _, (long,)), (same, _, (short,)) = found
    assert float(loss / same - 1) == pytest.approx(0, abs=1e-3)
    values, directions = torch.linalg.eigh(short.matrix)
    seen = directions[:, values > 1e-6 * values[-1]]
    ratios = torch.linalg.eigvals(
        torch.linalg.solve(seen.T @ short.matrix @ seen, seen.T @ long.matrix @ seen)
    )
    assert float((ratios.real - 1).abs().max()) < 1e-2  # twice what the trapezoids are off by in a day


@torch.no_grad()
def test_equations_of_functions_follow_mu_which_is_outside_networks():
    """A potential that does not decay can absorb mu: its derivative must be right to many digits."""
    dynamics, batch = satellite(rows=61)
    step = torch.zeros(sum(p.numel() for p in dynamics.parameters()), dtype=torch.float64)
    step[0] = 1e-2
    wide, own = linearised(dynamics, step)
    problem, weights = WideProblem(wide, batch, ROBUST["none"]), parameters_to_vector(wide.parameters())
    found, exact = (
        of_functions(problem, dynamics, weights, own).gradient[0],
        problem.gradient(weights)[own][0],
    )
    assert float(found / exact - 1) == pytest.approx(
        0, abs=1e-3
    )  # before the step the derivative is 1 % less

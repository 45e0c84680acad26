"""The weak form of second order: a force from positions alone, whose momenta nobody sees."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator
from oscillators import DOUBLE, Swing
from torch import nn
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics.energies import Quadratic
from ahnn.dynamics.hamiltonians import SeparableHamiltonian
from ahnn.errors import UserError
from ahnn.measurements import Instrument, Position, Segment, State
from ahnn.rollouts import rollout
from ahnn.shooting.path_sensitivities import path
from ahnn.systems import Molniya
from ahnn.systems.truth import exact_flow
from ahnn.training import LevenbergMarquardt
from ahnn.training.banded import BandedFactor
from ahnn.training.weak import Weak
from ahnn.training.weak_test_functions import bumps, integrated


class Potential(nn.Module):
    """k q^2 / 2 + c q^4 / 4."""

    def __init__(self, *stiffness):
        super().__init__()
        self.stiffness = nn.Parameter(torch.tensor(stiffness, **DOUBLE))

    def gradient(self, q):
        return self.stiffness[0] * q + self.stiffness[1] * q**3


class Well(Swing):
    def __init__(self, *stiffness):
        nn.Module.__init__(self)
        self.field = SeparableHamiltonian(Quadratic(2.0), Potential(*stiffness))


def positions(rows, sd):
    """Of a swing of mass 2 in the potential q^2 / 2 + q^4 / 8, whose momenta nobody sees."""
    well = Well(1.0, 0.5)
    x = torch.randn(rows, 2, generator=generator(0), **DOUBLE)
    truth = path(well.increment, x, torch.full((rows, 200), 0.05, **DOUBLE))[..., :1]
    noise = sd * torch.randn(truth.shape, generator=generator(2), **DOUBLE)
    times = 0.05 * torch.arange(201, **DOUBLE).expand(rows, -1)
    return Segment(
        truth + noise, times, Instrument(Position(1), torch.full((1,), sd, **DOUBLE), 0.05, 1, 1.0, 12)
    )


@torch.no_grad()
def test_the_integrals_of_rare_positions_are_exact_beside_the_noise():
    """A sample every five minutes, three on either side of one over which the motion is a cubic."""
    system = Molniya(dt=300.0, steps=288, name="molniya")
    truth = rollout(exact_flow(system), system.initial_states(4, generator(0)), 300.0, 289)[..., :3]
    tests = bumps(300.0 * torch.arange(289, **DOUBLE)[None], torch.ones(1, 289, dtype=torch.bool), 3, order=2)
    sums = integrated(tests.on_field, tests.stride, system.force(truth))
    sums = sums + integrated(tests.on_data, tests.stride, truth)
    left = BandedFactor.of(tests.covariances(3)).whiten((sums / 0.1).unsqueeze(-1))
    assert float(left.square().mean()) < 0.01


def test_a_force_is_found_from_noisy_positions_alone():
    model, batch = Well(0.3, 0.0), positions(200, 0.01)
    for relative, steps in ((True, 4), (False, 4)):
        optimizer = LevenbergMarquardt(model.parameters(), damping=1e-4)
        for _ in range(steps):
            optimizer.step(lambda relative=relative: (Weak(relative=relative).problem(model, batch), None))
    close(model.field.potential.stiffness, torch.tensor([1.0, 0.5]), 3e-3)
    problem = Weak().problem(model, batch)
    loss, degrees, _ = problem.equations(parameters_to_vector(model.parameters()).detach(), [2])
    close(loss / degrees, torch.tensor(1.0, **DOUBLE), 0.1)


def test_positions_tell_nothing_of_a_field_whose_momenta_are_unknown():
    with pytest.raises(UserError, match=r"positions with a known kinetic energy; received Position"):
        Weak().problem(Swing(), positions(2, 0.01))


@torch.no_grad()
def test_a_force_that_is_wrong_is_no_doubt_about_velocities():
    """Each kind of quantity has a share of its own by which the field misses it, in any dimension."""
    x = torch.randn(30, 6, generator=generator(0), **DOUBLE)
    truth = path(Well(1.0, 0.5).increment, x, torch.full((30, 200), 0.05, **DOUBLE))
    times = 0.05 * torch.arange(201, **DOUBLE).expand(30, -1)
    instrument = Instrument(State(3), torch.full((6,), 0.01, **DOUBLE), 0.05, 3, 2.0, 12)
    wrong = Well(1.2, 0.6)
    problem = Weak(relative=True).problem(wrong, Segment(truth, times, instrument))
    nearest, *_ = problem._bands(slice(None), None)
    missed = problem._missed(problem.motion.right(wrong.field), nearest.diagonal(dim1=-2, dim2=-1))
    assert float(missed[..., :3].max()) == 0.0
    assert float(missed[..., 3:].amin()) > 0.0


@pytest.mark.parametrize("measurement", [State(1), Position(1)], ids=["states", "positions"])
def test_equations_of_known_velocities_are_those_of_the_residuals(measurement):
    """Parameters move momenta alone: the rows of positions are zeros, above those of momenta."""
    model, seen = Well(1.2, 0.4), positions(3, 0.01)
    if isinstance(measurement, State):
        momenta = 2 * torch.gradient(seen.values, spacing=0.05, dim=1)[0]
        sds = torch.tensor([0.01, 0.3], **DOUBLE)
        instrument = seen.instrument._replace(measurement=measurement, deviations=sds)
        seen = seen._replace(values=torch.cat((seen.values, momenta), -1), instrument=instrument)
    problem, theta = Weak().problem(model, seen), torch.tensor([1.2, 0.4], **DOUBLE)
    loss, _, (block,) = problem.equations(theta, [2])
    with torch.no_grad():
        at = lambda shift: problem.integrals(problem._at(theta + shift), slice(None)).flatten()  # noqa: E731
        numeric = torch.stack([(at(d) - at(-d)) / 2e-5 for d in 1e-5 * torch.eye(2, **DOUBLE)], -1)
        close(block.matrix, numeric.T @ numeric, 1e-5)
        close(block.gradient, numeric.T @ at(0.0), 1e-5)
        close(loss, at(0.0).square().sum(), 1e-12)


@torch.no_grad()
def test_validation_is_chi_square_for_each_degree_of_freedom():
    seen, right, wrong = positions(20, 0.01), Well(1.0, 0.5), Well(1.3, 0.5)
    for model, least, most in ((right, 0.9, 1.1), (wrong, 2.0, 1e9)):
        problem = Weak().problem(model, seen)
        squares = problem.integrals(problem.motion.right(model.field), slice(None)).square()
        found = Weak().validation(model, seen)["loss"]
        close(found, squares.sum() / squares.numel(), 1e-12)
        assert least < float(found) < most

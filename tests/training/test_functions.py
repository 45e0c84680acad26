"""The last step of a training, taken by functions: where it leads, what it takes as known, what is left."""

from __future__ import annotations

import math

import pytest
import torch
from helpers import close, generator
from oscillators import Swing, segment
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import make_dynamics
from ahnn.dynamics.linearised import linearised
from ahnn.measurements import Position
from ahnn.shooting.quadrature import rule_error
from ahnn.shooting.robust import ROBUST
from ahnn.training import functions, laplace
from ahnn.training.evidence import Prior
from ahnn.training.functions import ARRIVED, mixed
from ahnn.training.laplace import conclude
from ahnn.training.maximum_posterior import (
    PosteriorPoint,
    WideProblem,
    after,
    of_functions,
    whole_problem,
)
from ahnn.training.normal_equations import Block

DOUBLE = {"dtype": torch.float64}


def flat(model):
    return parameters_to_vector(model.parameters()).detach()


def batch_of(seed, rows=40, longest=0.05):
    return segment(rows=rows, intervals=20, measurement=Position(1), seed=seed, longest=longest)[1]


def nearly(rows=60, beside=0.01):
    """Positions that a network for V(q) made, and the network a little beside."""
    torch.manual_seed(0)
    options = {"dof": 1, "inertia": 1.0, "hamiltonian": "mechanical", "mu": None, "inputs": "cartesian"}
    options |= {"scaling": "none", "integrator": {"name": "rk4"}}
    network = {"width": 6, "depth": 2, "activation": "tanh"}
    model = make_dynamics("hamiltonian", **options, network=network).double()
    model.field.potential.network.output.weight.data.mul_(30)
    _, batch = segment(rows=rows, measurement=Position(1), longest=0.05, dynamics=model)
    for k, p in enumerate(model.parameters()):
        p.data.add_(beside * torch.randn(p.shape, generator=generator(k), **DOUBLE))
    return model, batch


@pytest.fixture
def started():
    """A model, its problem, and the place where it begins."""
    model, batch = nearly()
    problem = WideProblem(model, batch, ROBUST["none"])
    here = laplace.place(problem, flat(model), [p.numel() for p in model.parameters()])
    assert here.remaining > 20
    return model, problem, here


def test_the_gradient_in_reverse_is_that_of_the_normal_equations(started):
    model, problem, here = started
    close(problem.gradient(flat(model)), here.block.gradient, 1e-5)


@pytest.mark.slow
def test_functions_take_the_steps_to_the_optimum_that_parameters_cannot(started):
    model, problem, here = started
    found = conclude(model, problem.batch, batch_of(1, rows=10), 0)
    close(found.step, here.offset, 0.1)
    assert found.about["remaining"] <= ARRIVED * found.about["determined"]
    assert found.about["chi_square"] < here.chi_square
    # Nothing is left by an independent measure: central differences of residuals and prior.
    learned, known = found.taken(model)
    strengths = Prior(torch.tensor(list(found.about["strengths"].values()), **DOUBLE), here.prior.sizes)

    def objective(direction, share):
        wide, _ = linearised(model, found.step + share * direction)
        moved = WideProblem(wide, problem.batch, ROBUST["none"])
        return float(moved.cost + strengths.penalty(flat(model) + found.step + share * direction))

    for direction in found.factor.T[:3]:
        slope = (objective(direction, 1.0) - objective(direction, -1.0)) / 4
        assert slope**2 < ARRIVED * found.about["determined"]
    assert known.offset.norm() > 0
    assert learned.spec["network"]["width"] == 18


def test_equations_of_functions_are_in_the_step_that_they_are_linear_in(started):
    """Their gradient is the exact one, of the parameters at the places of theta."""
    model, problem, here = started
    wide, own = linearised(model, 0.5 * here.offset)
    there, weights = after(problem, wide), flat(wide)
    block = of_functions(there, model, weights, own)
    assert block.matrix.shape == (len(own), len(own))
    exact = there.gradient(weights)[own]
    close(block.gradient, exact, 1e-4)
    assert (exact - here.block.gradient).norm() > 0.1 * exact.norm()  # the half of the step is not nothing
    close(
        there.equations(weights, [])[2][0].matrix[own][:, own], block.matrix, 1e-4
    )  # ordinary columns again


@pytest.mark.slow
def test_a_long_step_has_equations_of_its_own(monkeypatch):
    """Beside by three times as much paths bend so that one matrix leads nowhere."""
    model, batch = nearly(beside=0.2)
    other, ends = batch_of(1, rows=10), []
    for matrices in (1, 3):
        monkeypatch.setattr(functions, "MATRICES", matrices)
        ends.append(conclude(model, batch, other, 0).about)
    assert ends[0]["remaining"] > ARRIVED * ends[0]["determined"]
    assert ends[1]["remaining"] <= ARRIVED * ends[1]["determined"]


def test_a_mixture_of_places_solves_linear_equations():
    """Gradients of a quadratic, whose matrix is other than that of the steps in two directions."""
    curvature = torch.diag(torch.tensor([1.0, 1.0, 1.8, 0.4], **DOUBLE))
    best = torch.tensor([1.0, -2.0, 3.0, 0.5], **DOUBLE)
    block = Block(torch.arange(4), torch.eye(4, **DOUBLE), torch.zeros(4, **DOUBLE))
    prior = Prior(torch.tensor([1e-12], **DOUBLE), (4,))
    theta, places = torch.zeros(4, **DOUBLE), []
    start = PosteriorPoint.of(theta, theta.sum(), 100, block, prior)
    for _ in range(4):
        places.append(start.moved(theta, theta.sum(), curvature @ (theta - best)))
        theta = mixed(places)
    close(theta, best, 1e-6)


def test_steps_of_functions_that_do_not_pay_are_not_taken(started, monkeypatch):
    model, problem, _ = started
    wrong = lambda dynamics, step: linearised(dynamics, -step)  # noqa: E731
    monkeypatch.setattr(functions, "linearised", wrong)
    monkeypatch.setattr(functions, "STEPS", 1)
    monkeypatch.setattr(laplace, "FURTHER", 0)
    found = conclude(model, problem.batch, batch_of(1, rows=10), 0)
    assert found.step is None
    assert found.about["remaining"] > 20


@pytest.mark.slow
def test_functions_take_no_step_from_the_optimum(monkeypatch):
    model, batch = nearly()
    monkeypatch.setattr(functions, "ARRIVED", 1e6)
    assert conclude(model, batch, batch_of(1, rows=10), 3).step is None


def test_the_error_of_the_trapezoidal_rule_is_read_off_paths():
    """Along a harmonic motion second differences of the force are 2 (cos w dt - 1) of it."""
    still = make_dynamics(
        "hamiltonian",
        dof=1,
        inertia=1.0,
        hamiltonian="mechanical",
        mu=None,
        inputs="cartesian",
        scaling="none",
        integrator={"name": "rk4"},
        network={"width": 2, "depth": 1, "activation": "tanh"},
    ).double()
    still.field.force = lambda q: -4.0 * q
    t = 0.3 * torch.arange(200, **DOUBLE)
    states = torch.stack(((2 * t).sin(), 2 * (2 * t).cos()), dim=-1).unsqueeze(0)
    error = rule_error(still.field, states, torch.full((1, 199), 0.3, **DOUBLE))
    assert error.tolist() == pytest.approx([(1 - math.cos(0.6)) / 6], rel=1e-2)


@pytest.mark.parametrize(("longest", "quartered"), [(0.05, False), (0.5, True)])
def test_long_steps_are_quartered_and_know_their_gradient(longest, quartered):
    batch = batch_of(0, longest=longest)
    at = (2.003, 0.497)  # so near that no segment is limited
    problem = whole_problem(Swing(*at), batch, ROBUST["none"])
    assert problem.steps.quartered == quartered
    _, _, (block,) = problem.equations(flat(Swing(*at)), [2])

    def cost(shift):
        moved = Swing(at[0] + float(shift[0]), at[1] + float(shift[1]))
        return float(
            WideProblem(moved, batch, ROBUST["none"], starts=problem.starts, quartered=quartered).cost
        )

    for k, e in enumerate(1e-4 * torch.eye(2, **DOUBLE)):
        slope = (cost(e) - cost(-e)) / 4e-4
        assert float(block.gradient[k]) == pytest.approx(slope, rel=2e-3)
        assert float(problem.gradient(flat(Swing(*at)))[k]) == pytest.approx(slope, rel=2e-3)

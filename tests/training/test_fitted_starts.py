"""Windows from the starts that fit them best: against integrated paths, differences and known constants."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from ahnn.clock import Clock, extended
from ahnn.dynamics import make_dynamics
from ahnn.errors import UserError
from ahnn.rollouts import rollout
from ahnn.training import LevenbergMarquardt, Loss, LossOptions
from ahnn.training.fitted_starts import APART, FittedStarts
from ahnn.training.least_squares import LeastSquares
from ahnn.training.objectives import OBJECTIVES
from ahnn.types import Window

DOUBLE = {"dtype": torch.float64}
STEPS, DT = 120, 0.02
PULL = {"pull": {"kind": "spring", "stiffness": 4.0}}
EARTH = {"planet": {"kind": "central_attraction", "mu": 1.0}}
TURNING = {"kind": "elliptic_equator", "mu": 1.0, "radius": 1.0, "angle": 0.3, "rate": 0.9}


def dynamics(forces, dof=3):
    torch.manual_seed(1)
    options = {"dof": dof, "inertia": 1.0, "inputs": "cartesian", "scaling": "none", "mu": None}
    options |= {"network": {"width": 5, "depth": 1, "activation": "tanh"}, "integrator": {"name": "rk4"}}
    return make_dynamics("hamiltonian", hamiltonian="mechanical", forces=forces, **options).double()


def objective(model, steps=STEPS):
    return FittedStarts(Loss(2 * (3 + model.clock), LossOptions()).double(), steps)


def windows(model, states, dt=DT):
    """Windows of states (B, T, 6) that begin at times 0, 1, 2, ..."""
    times = torch.arange(len(states), **DOUBLE).unsqueeze(1) + dt * torch.arange(states.shape[1], **DOUBLE)
    z = extended(states, Clock.of(times, None)) if model.clock else states
    return Window(z[:, 0], z.diff(dim=1), dt)


def orbits(model, count=4, steps=STEPS):
    """Eccentric orbits about a centre of unit attraction, followed by a model."""
    start = torch.tensor([0.8, 0.1, 0.0, -0.1, 1.1, 0.3], **DOUBLE)
    start = start + 0.1 * torch.randn(count, 6, generator=generator(2), **DOUBLE)
    times = torch.arange(count, **DOUBLE).unsqueeze(1) + DT * torch.arange(steps + 1, **DOUBLE)
    return rollout(model, start, DT, steps + 1, clock=Clock.of(times, None) if model.clock else None)


def test_what_is_left_is_what_integrated_paths_leave_from_their_best_starts():
    """Motion that is linear, so that the linearisation is exact, beside data of another frequency."""
    model = dynamics(PULL)
    t = DT * torch.arange(STEPS + 1, **DOUBLE)
    size = torch.randn(5, 2, 3, generator=generator(0), **DOUBLE)
    q = size[:, :1] * (2.2 * t).cos().unsqueeze(-1) + size[:, 1:] * (2.2 * t).sin().unsqueeze(-1)
    states = torch.cat((q, torch.zeros_like(q)), dim=-1)
    found = objective(model).residuals(model, windows(model, states))
    whole = rollout(model, torch.eye(6, **DOUBLE), DT, STEPS + 1)[:, ::APART, :3].flatten(1).T
    wanted = q[:, ::APART].flatten(1).T
    left = whole @ torch.linalg.lstsq(whole, wanted).solution - wanted
    assert float(left.norm() / wanted.norm()) > 1e-3
    close(found, left.T, 1e-9)


@pytest.mark.parametrize("forces", [PULL, {**EARTH, "equator": TURNING}], ids=["autonomous", "of time"])
def test_derivatives_by_parameters_are_differences_of_what_is_left(forces):
    model = dynamics(forces)
    states = orbits(model)
    theta = parameters_to_vector(model.parameters()).detach()
    theta = theta + 1e-5 * torch.randn(len(theta), generator=generator(3), **DOUBLE)
    with torch.no_grad():
        vector_to_parameters(theta, model.parameters())
    about = objective(model)
    batch = windows(model, states)
    problem = about.problem(model, batch)
    rows = problem.jacobian(theta)
    for k in range(0, len(theta), 3):
        by = 1e-5 * torch.eye(len(theta), **DOUBLE)[k]
        slope = (problem.residuals(theta + by) - problem.residuals(theta - by)) / 2e-5
        assert float((rows[:, k] - slope.detach()).norm()) < 5e-2 * float(slope.norm()) + 1e-7
    close(about.residuals(model, batch).flatten(), problem.residuals(theta), 1e-12)
    (slope,) = torch.autograd.grad(
        about.residuals(model, batch).square().sum() / 2, [next(model.parameters())]
    )
    close(slope.flatten(), (rows.T @ problem.residuals(theta))[: slope.numel()], 1e-2)


def test_harmonics_are_found_from_starts_that_are_wrong():
    """Velocities of the samples are off as those of a theory may be: only positions tell."""
    true = dynamics({**EARTH, "equator": {**TURNING, "cosine": 2e-3, "sine": -1e-3}})
    states = orbits(true, steps=200)
    states[..., 3:] *= 1.0005
    model = dynamics({**EARTH, "equator": TURNING})
    about, batch = objective(model, 200), windows(model, states)
    before = float(about.validation(model, batch)["loss"])
    for parameter in model.field.hamiltonian.parameters():
        parameter.requires_grad_(False)
    step = LevenbergMarquardt([model.field.forces["equator"].harmonics], damping=1e-9)
    assert about.divided(batch) == (batch, None)
    for _ in range(2):
        problem = about.problem(model, batch)
        theta, own = parameters_to_vector(model.parameters()).detach(), slice(-2, None)

        def residuals(part, problem=problem, theta=theta):
            return problem.residuals(torch.cat((theta[:-2], part)))

        rows = problem.jacobian(theta)[:, own]
        own_problem = LeastSquares(residuals, lambda _, rows=rows: rows)
        step.step(lambda own_problem=own_problem: (own_problem, None))
    found = model.field.forces["equator"].harmonics.detach()
    close(found, torch.tensor([2e-3, -1e-3], **DOUBLE), 0.02)
    assert float(about.validation(model, batch)["loss"]) < 1e-3 * before


def test_unequal_steps_and_maps_without_a_field_are_refused():
    model = dynamics(PULL)
    batch = windows(model, torch.zeros(2, STEPS + 1, 6, **DOUBLE))
    with pytest.raises(UserError, match=r"equal steps; received steps that differ"):
        objective(model).residuals(model, batch._replace(dt=torch.full((2, STEPS), DT)))
    network = {"width": 5, "depth": 1, "activation": "tanh"}
    direct = make_dynamics("map", dof=3, scaling="none", residual=True, network=network).double()
    with pytest.raises(UserError, match=r"dynamics with a field .* received NextState"):
        objective(direct).residuals(direct, batch)
    assert OBJECTIVES["fitted_starts"] is FittedStarts

"""Tasks of noisy states: drawings against closed forms, fits of starts against known optima."""

from __future__ import annotations

import json

import pytest
import torch
from helpers import close

from ahnn.rollouts import rollout
from ahnn.systems import HenonHeiles
from ahnn.systems.truth import exact_flow
from ahnn.tasks import TASKS, free_forms, one_orbit, three_points
from ahnn.tasks.definition import numbers
from ahnn.tasks.shooting_fit import fitted_constants, fitted_start, least_squares

DOUBLE = {"dtype": torch.float64}
HENON = three_points.well([1.0] * 4)
UNEVEN = three_points.well([0.9, 1.2, 0.8, 1.1])


def test_least_squares_find_the_minimum_of_a_line_and_of_a_curved_valley():
    x = torch.linspace(0, 1, 7, **DOUBLE)
    seen = 2 - 3 * x + torch.sin(40 * x)
    found = least_squares(
        lambda z: z[:, :1] + z[:, 1:] * x - seen, torch.zeros(2, **DOUBLE), torch.full((2,), 1e-4, **DOUBLE)
    )
    close(found, torch.linalg.lstsq(torch.stack((torch.ones_like(x), x), 1), seen[:, None])[0][:, 0], 1e-6)
    valley = least_squares(
        lambda z: torch.stack((10 * (z[:, 1] - z[:, 0] ** 2), 1 - z[:, 0]), 1),
        torch.tensor([-1.2, 1.0], **DOUBLE),
        torch.full((2,), 1e-6, **DOUBLE),
    )
    close(valley, torch.ones(2, **DOUBLE), 1e-6)


def test_a_fitted_start_of_a_spring_is_that_of_linear_least_squares():
    """Motion is linear in the start, so that the normal equations say which is best."""

    def spring(x, steps, dt):
        phase = (dt * torch.arange(steps + 1, **DOUBLE))[None, :, None]
        q, p = x[:, None, :1], x[:, None, 1:]
        return torch.cat((q * phase.cos() + p * phase.sin(), p * phase.cos() - q * phase.sin()), -1)

    exact = spring(torch.tensor([[0.3, -1.1]], **DOUBLE), 30, 0.2)[0]
    noisy = exact + 0.1 * torch.as_tensor(numbers(4).standard_normal((31, 2)))
    found = fitted_start(spring, noisy, 0.2, (11, 31))
    columns = spring(torch.eye(2, **DOUBLE), 30, 0.2).flatten(1).T
    close(found, torch.linalg.lstsq(columns, noisy.reshape(-1, 1))[0][:, 0], 1e-7)


@pytest.fixture(scope="module")
def orbit():
    return one_orbit.draw(6)


def test_one_orbit_has_the_said_noise_in_three_places_and_its_drawing_says_so(orbit):
    assert orbit.data.states.shape == (21, 23, 4)
    close(orbit.data.times[:7].flatten(), 0.25 * torch.arange(161, **DOUBLE), 1e-12)
    for x in (orbit.data.states, orbit.data.times):
        assert torch.equal(x[:7], x[7:14])
        assert torch.equal(x[:7], x[14:])
    states = orbit.data.states[:7].flatten(0, 1)
    exact = one_orbit.true_motion(one_orbit.begin(6), 160, 0.25)[0]
    sd = torch.tensor(json.loads(orbit.options[0].removeprefix("data.noise=")), **DOUBLE)
    close(sd.square(), 0.05 * exact.var(0, correction=0), 1e-12)
    close((states - exact).square().mean(0).sqrt(), sd, 0.15)


def test_motion_of_a_coupling_of_four_fifths_conserves_its_own_energy():
    x = one_orbit.true_motion(one_orbit.begin(0), 40, 0.25)
    (a, b), p = x[..., :2].unbind(-1), x[..., 2:]
    energy = (p.square().sum(-1) + a**2 + b**2) / 2 + 0.8 * (a**2 * b - b**3 / 3)
    assert float(energy[0, 0]) < 1 / (6 * 0.8**2)
    assert float((energy - energy[:, :1]).abs().max()) < 1e-9


def test_the_floor_of_one_orbit_is_that_of_the_noise_and_a_wrong_pace_is_worse(monkeypatch):
    """A quarter of a regular orbit: 164 numbers of 22 % noise fix four unknowns."""
    monkeypatch.setattr(one_orbit, "DURATION", 10.0)
    monkeypatch.setattr(one_orbit, "PIECES", 1)
    monkeypatch.setattr(one_orbit, "HORIZONS", (21, 41))
    short = one_orbit.draw(6)
    floor = short.floor()
    assert 0.01 < floor < 0.3
    slow = lambda x, steps, dt: one_orbit.true_motion(x, steps, 0.9 * dt)  # noqa: E731
    assert short.score(slow) > 2 * floor


@pytest.mark.parametrize("name", ["points_henon_heiles", "points_fermi_pasta", "points_double_pendulum"])
def test_three_points_are_noisy_states_of_the_true_flow(name, monkeypatch):
    noisy = TASKS[name].draw(2)
    monkeypatch.setattr(three_points, "NOISE", 0.0)
    clean = TASKS[name].draw(2)
    assert clean.data.states.shape == (300, 4, 4)
    close((noisy.data.states - clean.data.states).std(), torch.tensor(0.05, **DOUBLE), 0.05)
    radius = clean.data.states[:, 0].norm(dim=-1)
    assert 0.3 <= float(radius.min()) < 0.33
    assert 0.64 < float(radius.max()) <= 0.45**0.5
    about = TASKS[name].draw.keywords
    system = about["form"](about["constants"])
    energy = system.energy(clean.data.states)
    assert float((energy - energy[:, :1]).abs().max()) < 1e-8
    flow = exact_flow(system)
    assert clean.score(lambda x, steps, dt: rollout(flow, x, dt, steps + 1)) < 1e-12


def test_a_flow_error_is_the_norm_of_the_mean_error_and_its_rms_that_of_each_number():
    draw = TASKS["points_henon_heiles"].draw(0)
    flow = exact_flow(HENON)
    off = torch.tensor([3.0, 0.0, -4.0, 0.0], **DOUBLE)

    def late(x, steps, dt):
        return rollout(flow, x, dt, steps + 1) + off * torch.tensor([0.0, 1, 1, 1], **DOUBLE)[:, None]

    assert draw.score(late) == pytest.approx(5 * 3 / 4, rel=1e-9)
    assert draw.also["rms error"](late) == pytest.approx(2.5, rel=1e-9)


@pytest.mark.parametrize("system", [HENON, three_points.stiff_chain([1.7, 0.6]), UNEVEN], ids=repr)
def test_planar_forms_are_pulled_by_the_slope_of_their_energy(system):
    x = free_forms.begin(6, 4, numbers(0)).requires_grad_()
    slope = torch.autograd.grad(system.energy(x).sum(), x)[0]
    close(system(x), torch.cat((slope[:, 2:], -slope[:, :2]), 1), 1e-12)


def test_henon_heiles_is_the_well_of_all_ones():
    x = free_forms.begin(6, 4, numbers(1))
    system = HenonHeiles(name="henon_heiles", dt=0.8, steps=3)
    close(HENON.energy(x), system.energy(x), 1e-13)
    close(HENON(x), system(x), 1e-13)


def test_fitted_constants_of_a_spring_are_those_that_made_it_and_their_error_is_that_of_the_noise():
    """Motion of q'' = -w^2 q, from w^2 = 1.3: without noise exact, with it as the information says."""

    def spring(constants):
        w = constants[0].sqrt()

        def predict(x, steps, dt):
            phase = (w * dt * torch.arange(steps + 1, **DOUBLE))[None, :, None]
            q, p = x[:, None, :1], x[:, None, 1:]
            return torch.cat(
                (q * phase.cos() + p / w * phase.sin(), p * phase.cos() - w * q * phase.sin()), -1
            )

        return predict

    truth = torch.tensor([1.3], **DOUBLE)
    exact = spring(truth)(free_forms.begin(60, 2, numbers(0)), 3, 0.8)
    close(fitted_constants(spring, exact, 0.8, torch.ones(1, **DOUBLE)), truth, 1e-9)
    found = [
        fitted_constants(
            spring, exact + 0.05 * torch.as_tensor(numbers(k, 1).standard_normal(exact.shape)), 0.8, truth
        )
        for k in range(40)
    ]
    spread = torch.cat(found) - truth
    expected = 0.05 * information(spring, exact, truth).rsqrt()
    close(spread.square().mean().sqrt(), expected, 0.35)
    assert abs(float(spread.mean())) < 3 * float(expected) / 40**0.5 + 0.05 * float(expected)


def information(predict_of, exact, constants):
    """Fisher information of one constant, starts unknown, for a noise of 1: by linear motion in the start."""
    step = 1e-5
    ahead, behind = (predict_of(constants + by)(exact[:, 0], 3, 0.8) for by in (step, -step))
    of_constant = ((ahead - behind) / (2 * step)).flatten(1)
    columns = predict_of(constants)(torch.eye(2, **DOUBLE), 3, 0.8).flatten(1).T
    orthogonal = torch.linalg.qr(columns).Q
    return (of_constant - of_constant @ orthogonal @ orthogonal.T).square().sum()

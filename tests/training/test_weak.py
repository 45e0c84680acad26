"""The weak form: zero for the true field, white for noise, and a field from noisy states."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
import torch
from helpers import close, generator
from test_shooting import DOUBLE, Swing
from torch import nn
from torch.nn.utils import parameters_to_vector

from ahnn.errors import UserError
from ahnn.measurements import Instrument, Segment, State
from ahnn.rollouts import rollout
from ahnn.shooting.path_sensitivities import path
from ahnn.shooting.robust import ROBUST
from ahnn.systems import Molniya
from ahnn.systems.truth import exact_flow
from ahnn.training import (
    LevenbergMarquardt,
    Loss,
    LossOptions,
    Recursive,
    shooting,
    weak,
    weak_test_functions,
)
from ahnn.training.banded import BandedFactor
from ahnn.training.curriculum import objective_of
from ahnn.training.weak import Weak, WeakProblem
from ahnn.training.weak_test_functions import bumps, integrated, quadrature


@torch.no_grad()
def states(rows=30, samples=301, dt=0.02, sd=0.01, irregular=False):
    x = torch.randn(rows, 2, generator=generator(0), **DOUBLE)
    gaps = torch.full((rows, samples - 1), dt, **DOUBLE)
    if irregular:
        gaps = gaps * (0.8 + 0.4 * torch.rand(rows, samples - 1, generator=generator(1), **DOUBLE))
    truth = path(Swing().increment, x, gaps)
    times = torch.cat((torch.zeros(rows, 1), gaps.cumsum(1)), dim=1)
    noise = torch.randn(truth.shape, generator=generator(2), **DOUBLE)
    instrument = Instrument(State(1), torch.full((2,), max(sd, 1e-12), **DOUBLE), dt, 1, 1.0, 25)
    return Segment(truth + sd * noise, times, instrument)


def residuals(batch, model=None, robust="none", relative=False):
    problem = WeakProblem(model or Swing(), batch, ROBUST[robust], relative)
    return problem.integrals((model or Swing()).field, slice(None)), problem


@torch.no_grad()
def test_the_true_field_leaves_nothing_of_clean_states():
    batch = states(sd=0.0)._replace(instrument=states().instrument)
    wrong = float(residuals(batch, Swing(2.1, 0.5))[0].square().mean().sqrt())
    assert float(residuals(batch)[0].square().mean().sqrt()) < 3e-4 * wrong
    uneven = states(sd=0.0, irregular=True)._replace(instrument=batch.instrument)
    assert float(residuals(uneven)[0].square().mean().sqrt()) < 1e-2 * wrong


def test_sums_are_integrals_at_uneven_times():
    """Far better than by the trapezoidal rule; equal steps have equal weights, wild ones positive ones."""
    steps = 0.7 + 0.6 * torch.rand(3, 60, generator=generator(3), **DOUBLE)
    times = torch.nn.functional.pad(steps.cumsum(1), (1, 0))
    u = 2 * times / times[:, -1:] - 1
    bump = (1 - u * u) ** 4
    exact = times[:, -1] * 128 / 315  # of (1 - u^2)^4
    error = ((quadrature(times) * bump).sum(1) / exact - 1).abs().max()
    gaps = torch.nn.functional.pad(steps, (1, 1))
    trapezoidal = (((gaps[:, 1:] + gaps[:, :-1]) / 2 * bump).sum(1) / exact - 1).abs().max()
    assert float(error) < 0.1 * float(trapezoidal)
    close(quadrature(torch.arange(9, **DOUBLE).unsqueeze(0)), torch.ones(1, 9), 1e-15)
    wild = torch.tensor([[0.0, 1.0, 2.0, 102.0, 103.0, 104.0]], **DOUBLE)
    assert bool((quadrature(wild) > 0).all())


@torch.no_grad()
def test_the_integrals_of_an_orbit_are_exact_beside_the_noise():
    """A sample each minute. Five on either side are smooth beside 100 m of noise, and too few for a sum."""
    system = Molniya(dt=60.0, steps=1440, name="molniya")
    x = system.initial_states(4, generator(0))
    truth = rollout(exact_flow(system), x, 60.0, 721)
    deviations = torch.tensor([0.1] * 3 + [1e-4] * 3, **DOUBLE)
    instrument = Instrument(State(3), deviations, 60.0, 1, 1.0, 5)
    times = (60.0 * torch.arange(721, **DOUBLE)).expand(4, -1)
    tests = bumps(times[:1], torch.ones(1, 721, dtype=torch.bool), instrument.width)
    field = torch.cat((system.velocity(truth[..., 3:]), system.force(truth[..., :3])), dim=-1)
    sums = integrated(tests.on_field, tests.stride, field) + integrated(tests.on_data, tests.stride, truth)
    left = BandedFactor.of(tests.covariances(6)).whiten((sums / deviations).unsqueeze(-1))
    assert float(left.square().mean()) < 0.01


@torch.no_grad()
def test_the_noise_of_the_integrals_is_white():
    """That of the slopes and that of the field: the noise of momenta moves positions, and the other way."""
    model, clean = Swing(), states(rows=1, samples=151, sd=0.0).values
    noise = 0.01 * torch.randn(4000, 151, 2, generator=generator(4), **DOUBLE)
    batch = states(rows=4000, samples=151)._replace(values=clean + noise)
    integrals, problem = residuals(batch, model)
    flat = (integrals - integrals.mean(0)).flatten(1)
    covariance = flat.T @ flat / len(flat)
    assert float((covariance - torch.eye(len(covariance))).abs().max()) < 0.1
    alone = [band * torch.eye(2) for band in problem.tests.covariances(2)]
    sums = problem._sums(model.field, slice(None))
    white = BandedFactor.of(alone).whiten((sums - sums.mean(0)).unsqueeze(-1))
    assert float(white.square().mean()) > 1.1  # without the field's part they are too large


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("width", [3, 6, 20])
def test_sums_are_exact_for_polynomials_however_few_and_uneven_the_samples(monkeypatch, order, width):
    monkeypatch.setitem(weak_test_functions.NARROWEST, order, width)
    gaps = 0.8 + 0.4 * torch.rand(2, 60, generator=generator(5), **DOUBLE)
    times = torch.nn.functional.pad(gaps.cumsum(1), (1, 0)) / 60
    tests = bumps(times, torch.ones(2, 61, dtype=torch.bool), width, order)
    for degree in range(min(7, 2 * width - 2) + 1):
        factor = math.prod(degree - k for k in range(order))
        rate = factor * times ** max(degree - order, 0)
        of_field = integrated(tests.on_field, tests.stride, rate.unsqueeze(-1))
        of_data = integrated(tests.on_data, tests.stride, times.unsqueeze(-1) ** degree)
        size = integrated(tests.on_data.abs(), tests.stride, times.unsqueeze(-1) ** degree)
        assert float(((of_field + of_data) / size).abs().max()) < 1e-8


class Saturating(nn.Module):
    """The field of H = p^2 / 2 + k log cosh(c q) / c."""

    def __init__(self, *theta):
        super().__init__()
        self.theta = nn.Parameter(torch.tensor(theta, **DOUBLE))

    def forward(self, x):
        q, p = x.chunk(2, -1)
        return torch.cat((p, -self.theta[0] * torch.tanh(self.theta[1] * q)), -1)


class Bent(Swing):
    def __init__(self, *theta):
        nn.Module.__init__(self)
        self.field = Saturating(*theta)


def test_a_missing_sample_takes_its_integrals_away_and_no_others(monkeypatch):
    monkeypatch.setitem(weak.WIDTHS, 1, 1)  # spans are as narrow where nothing is missing
    batch = states(rows=2)
    values = batch.values.clone()
    values[1, 150] = torch.nan
    wide = batch.instrument._replace(
        deviations=2 * batch.instrument.deviations
    )  # no share of the field is missing
    batch = batch._replace(instrument=wide)
    whole, full = residuals(batch)
    got, problem = residuals(batch._replace(values=values))
    gone = (got[1] == 0).all(-1)
    assert torch.equal(got[0], whole[0])
    assert 0 < int(gone.sum()) < len(gone) / 2
    assert problem.count == full.count - 2 * int(gone.sum())


def test_equations_are_those_of_the_residuals():
    batch, model = states(rows=5), Swing(2.1, 0.4)
    problem = WeakProblem(model, batch, ROBUST["huber"])
    theta = parameters_to_vector(model.parameters()).detach()
    loss, _, (block,) = problem.equations(theta, [2])
    objective = Weak("huber")
    (gradient,) = torch.autograd.grad(
        objective.residuals(model, batch).square().sum() / 2, model.field.stiffness
    )
    close(block.gradient, gradient, 1e-5)
    with torch.no_grad():
        plain = problem.integrals(model.field, slice(None))
    close(loss, problem.robust.cost(plain).sum(), 1e-12)
    close(problem.loss(theta), loss, 1e-12)
    e = 1e-5
    with torch.no_grad():
        weight = problem.robust.weight(plain).sqrt()
        at = lambda shift: problem.integrals(problem._at(theta + shift), slice(None)) * weight  # noqa: E731
        columns = [(at(e * d) - at(-e * d)).flatten() / (2 * e) for d in torch.eye(2, **DOUBLE)]
    numeric = torch.stack(columns, -1)
    close(block.matrix, numeric.T @ numeric, 1e-4)


@pytest.mark.parametrize("robust", ["none", "huber"])
def test_the_bend_is_the_second_derivative_of_the_residuals(robust):
    """With a force k tanh(c q), which is linear in k and not in c."""
    batch, model = states(rows=5), Bent(2.0, 0.7)
    problem = WeakProblem(model, batch, ROBUST[robust])
    theta, step = torch.tensor([2.0, 0.7], **DOUBLE), torch.tensor([0.01, 0.03], **DOUBLE)
    field = lambda t: Bent(*t.tolist()).field  # noqa: E731
    with torch.no_grad():
        here = problem.integrals(field(theta), slice(None))
        along = lambda d, e: problem.integrals(field(theta + e * d), slice(None))  # noqa: E731
        second = along(step, 0.1) - 2 * here + along(step, -0.1)
        columns = [(along(d, 1e-5) - along(d, -1e-5)) / 2e-5 for d in torch.eye(2, **DOUBLE)]
        weighted = problem.robust.weight(here) * second / 0.01
        expected = torch.stack([(column * weighted).sum() for column in columns])
    close(problem.bend(theta, step, 0.1), expected, 1e-5)
    zero = problem.bend(theta, torch.tensor([0.3, 0.0], **DOUBLE), 0.1)  # linear there
    assert float(zero.abs().max()) < 1e-8 * float(expected.abs().max())


def test_acceleration_is_refused_where_no_stage_knows_a_bend():
    optimizer = LevenbergMarquardt(Swing().parameters(), acceleration=True)
    for name in ("relative", "weak", "whole", 16):
        optimizer.check([objective_of(name, "none")])
    with pytest.raises(
        UserError, match=r"optimizer.acceleration: expected a loss on measurements .* received windows"
    ):
        optimizer.check([Recursive(Loss(2, LossOptions()), 5)])


def test_a_problem_without_a_bend_takes_straight_steps():
    batch, after = states(rows=3), []
    for acceleration in (True, False):
        model = Swing()
        optimizer = LevenbergMarquardt(model.parameters(), acceleration=acceleration)
        problem = Weak().problem(model, batch)
        unbent = SimpleNamespace(loss=problem.loss, equations=problem.equations)
        optimizer.step(lambda unbent=unbent: (unbent, None))
        after.append(parameters_to_vector(model.parameters()))
    assert torch.equal(*after)
    assert not torch.equal(after[0], parameters_to_vector(Swing().parameters()))


def test_a_field_is_found_from_noisy_states():
    model, batch = Swing(1.0, 0.0), states(rows=200)
    optimizer = LevenbergMarquardt(model.parameters(), damping=1e-4)
    for _ in range(6):
        optimizer.step(lambda: (Weak().problem(model, batch), None))
    close(model.field.stiffness, torch.tensor([2.0, 0.5]), 2e-3)


@torch.no_grad()
def test_a_wrong_field_counts_as_noise_by_the_share_that_is_wrong():
    """Stiffness and all: a force that is off by 3 % leaves residuals of which each costs one."""
    batch = states(rows=200)
    near, true = (residuals(batch, Swing(2.0 * s, 0.5 * s), relative=True)[1] for s in (1.03, 1.0))
    theta = torch.tensor([2.06, 0.515], **DOUBLE)
    momenta = near.integrals(Swing(*theta.tolist()).field, slice(None))[..., 1:]
    close(momenta.abs().median(), torch.tensor(0.6745, **DOUBLE), 0.2)
    plain = BandedFactor.of(true.tests.covariances(2))
    sums = near._sums(Swing(*theta.tolist()).field, slice(None))
    assert float(plain.whiten(sums.unsqueeze(-1))[..., 1, 0].square().mean()) > 3


@pytest.mark.parametrize("stage", ["relative", "weak", "whole"])
def test_parts_of_a_problem_have_the_same_bits_on_two_cores(two, stage):
    two.setattr(weak, "CELLS", 1.5e3)
    two.setattr(shooting, "CELLS", 1.5e3)
    model, batch = Swing(2.1, 0.4), states(rows=40, samples=101)
    theta = parameters_to_vector(model.parameters()).detach()
    problem = objective_of(stage, "none").problem(model, batch)
    assert len([*problem._parts(2)]) > 8
    loss, _, (block,) = problem.equations(theta, [2])
    two.setenv("OMP_NUM_THREADS", "1")
    alone, _, (single,) = objective_of(stage, "none").problem(model, batch).equations(theta, [2])
    assert torch.equal(block.matrix, single.matrix)
    assert torch.equal(block.gradient, single.gradient)
    assert torch.equal(loss, alone)


@torch.no_grad()
@pytest.mark.parametrize("irregular", [False, True])
def test_what_noise_does_to_a_trajectory_does_not_depend_on_others(irregular):
    """Of a field whose rates differ from sample to sample; more trajectories than are factored at once."""
    model, batch = Bent(2.0, 0.7), states(rows=2 * weak.SEGMENTS + 3, samples=101, irregular=irregular)
    together, _ = residuals(batch, model)
    for k in (0, weak.SEGMENTS - 1, weak.SEGMENTS, 2 * weak.SEGMENTS + 2):
        one = batch._replace(values=batch.values[k : k + 1], times=batch.times[k : k + 1])
        close(together[k : k + 1], residuals(one, model)[0], 1e-10)


@pytest.mark.parametrize("samples", [21, 24, 30])
def test_short_trajectories_have_a_few_spans(samples):
    """One alone, and fewer than overlap on a long one."""
    integrals, problem = residuals(states(rows=300, samples=samples, dt=0.1))
    assert problem.count == integrals.numel() > 0
    close(integrals.square().mean(), torch.tensor(1.0, **DOUBLE), 0.3)


@torch.no_grad()
def test_sums_with_a_missing_sample_count_for_nothing_beside_what_a_field_misses():
    batch = states()
    values = batch.values.clone()
    values[:, 150] = torch.nan
    found, problem = residuals(batch._replace(values=values), Swing(2.2, 0.4), relative=True)
    there = problem.tests.there
    assert 0 < int(there.sum()) < there.numel()
    assert bool(found.isfinite().all())
    assert float(found[~there].abs().max()) == 0
    assert float(found[there].abs().min(-1).values.max()) > 0

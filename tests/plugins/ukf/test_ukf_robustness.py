"""What must not hurt: outliers, bad members, bad conditioning."""

from __future__ import annotations

import math

import pytest
import torch

from ahnn.estimation import Gate, Status, initial_belief
from ahnn.measurements import GroundStation, Position
from ahnn_plugins.ukf import SQUARE_ROOT, STANDARD, UnscentedParameters, unscented_filter, unscented_smoother

FORMS = [SQUARE_ROOT, STANDARD]
F64 = torch.float64


def duffing(x, dt):
    p = x[:, 1] - dt * (x[:, 0] ** 3 - x[:, 0])
    return torch.stack((x[:, 0] + dt * p, p), dim=-1)


def duffing_run(batch=4, steps=80, seed=0, flow=duffing, rows=None, **options):
    generator = torch.Generator().manual_seed(seed)
    start = 1.0 + 0.1 * torch.randn(batch, 2, generator=generator, dtype=F64)
    noise = 0.05 * torch.randn(batch, steps, 1, generator=generator, dtype=F64)
    x, truth = start, []
    for _ in range(steps):
        x = duffing(x, 0.05)
        truth.append(x)
    truth = torch.stack(truth, 1)
    rows = truth[..., :1] + noise if rows is None else rows
    belief = initial_belief(start + 0.05, 0.01 * torch.eye(2))
    q, r = 1e-5 * torch.eye(2), 0.0025 * torch.eye(1)
    result = unscented_filter(flow, belief, rows, Position(1), q, r, 0.05, **options)
    return truth, rows, result


def test_the_gate_shrugs_off_one_outlier():
    gate = Gate(probability=0.9999, patience=5)
    truth, rows, clean = duffing_run(steps=200, gate=gate)
    assert not bool(clean.rejected.any())
    spoiled = rows.clone()
    spoiled[:, 100] += 100.0 * 0.05
    _, _, gated = duffing_run(steps=200, rows=spoiled, gate=gate)
    _, _, open_ = duffing_run(steps=200, rows=spoiled)

    def rmse(result):
        return (result.means - truth).square().mean().sqrt()

    assert gated.rejected.nonzero()[:, 1].unique().tolist() == [100]
    assert gated.status.tolist() == [0] * 4
    assert bool((gated.nis[:, 100] > 100.0).all())
    assert abs(rmse(gated) / rmse(clean) - 1.0) < 0.05
    assert rmse(open_) > 2.0 * rmse(clean)


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_a_run_of_rejections_is_divergence(form):
    _, rows, _ = duffing_run(steps=100)
    rows = rows.clone()
    rows[2, 40:] += 5.0
    # A gap does not end the run.
    rows[2, 42] = torch.nan
    gate = Gate(patience=20)
    _, _, result = duffing_run(steps=100, rows=rows, gate=gate, form=form)
    assert result.status.tolist() == [0, 0, Status.DIVERGED, 0]
    assert result.failed_step.tolist() == [-1, -1, 60, -1]
    assert bool(torch.isfinite(result.means[2, :60]).all())
    assert bool(torch.isnan(result.means[2, 60:]).all())


def overflowing(member, points, at_call, value):
    """Duffing flow that fails for the points of one member from one call on."""
    calls = 0

    def flow(x, dt):
        nonlocal calls
        out = duffing(x, dt)
        if calls >= at_call:
            out[member * points : (member + 1) * points] = value
        calls += 1
        return out

    return flow


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
@pytest.mark.parametrize("value", [math.nan, math.inf, 1e200])
def test_a_bad_member_leaves_the_others_bit_identical(form, value):
    _, _, clean = duffing_run(form=form, smoothing=True)
    flow = overflowing(member=1, points=5, at_call=30, value=value)
    # A constant output has no spread: only Q remains, and the size of the mean overflows nothing.
    _, _, spoiled = duffing_run(form=form, flow=flow, smoothing=True)
    others = [0, 2, 3]
    for name in ("means", "chols", "predicted_means", "predicted_chols", "innovations", "nis"):
        assert torch.equal(getattr(spoiled, name)[others], getattr(clean, name)[others]), name
    assert torch.equal(spoiled.log_likelihood[others], clean.log_likelihood[others])
    assert torch.equal(spoiled.means[1, :30], clean.means[1, :30])
    if not math.isfinite(value):
        assert spoiled.status.tolist() == [0, Status.NOT_FINITE, 0, 0]
        assert spoiled.failed_step.tolist() == [-1, 30, -1, -1]
        assert bool(torch.isnan(spoiled.means[1, 30:]).all())


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_members_do_not_depend_on_the_size_of_the_batch(form):
    _, rows, all_ = duffing_run(batch=125, steps=30, form=form)
    start = all_.initial
    for chosen in ([0], [3, 60], [*range(60), *range(61, 125)]):
        belief = start._replace(mean=start.mean[chosen], chol=start.chol[chosen])
        q, r = 1e-5 * torch.eye(2), 0.0025 * torch.eye(1)
        some = unscented_filter(duffing, belief, rows[chosen], Position(1), q, r, 0.05, form=form)
        assert torch.equal(some.means, all_.means[chosen])
        assert torch.equal(some.chols, all_.chols[chosen])


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_no_bit_depends_on_the_size_of_the_batch_in_six_dimensions(form):
    # The flow is elementwise: a matrix product of the user's may well depend on its number of rows.
    factors = torch.tensor([0.9, 1.0, 1.1, 0.95, 1.05, 1.0], dtype=F64)
    generator = torch.Generator().manual_seed(2)
    mean = torch.randn(125, 6, generator=generator, dtype=F64)
    rows = torch.randn(125, 20, 3, generator=generator, dtype=F64)
    rows[::7, 3, 1] = torch.nan
    root = torch.randn(6, 6, generator=generator, dtype=F64)

    def run(chosen):
        belief = initial_belief(mean[chosen], root @ root.mT)
        noise = 1e-3 * torch.eye(6), 0.1 * torch.eye(3)
        result = unscented_filter(
            lambda x, _: torch.sin(x.roll(1, -1)) * factors + 0.5 * x,
            belief,
            rows[chosen],
            Position(3),
            *noise,
            1.0,
            form=form,
            smoothing=True,
        )
        return result, unscented_smoother(result)

    everyone, everyone_smoothed = run(list(range(125)))
    for chosen in ([17], [7, 31, 90], [*range(50), *range(51, 125)]):
        some, smoothed = run(chosen)
        assert torch.equal(some.means, everyone.means[chosen])
        assert torch.equal(some.chols, everyone.chols[chosen])
        assert torch.equal(smoothed.means, everyone_smoothed.means[chosen])
        assert torch.equal(smoothed.chols, everyone_smoothed.chols[chosen])


def test_overflow_of_the_dynamics_gets_a_status():
    def explosive(x, dt):
        return x + dt * x**3

    start = torch.tensor([[0.1, 0.1], [50.0, 50.0]], dtype=F64)
    rows = torch.full((2, 40, 1), torch.nan, dtype=F64)
    belief = initial_belief(start, 1e-4 * torch.eye(2))
    q, r = 1e-8 * torch.eye(2), torch.eye(1)
    result = unscented_filter(explosive, belief, rows, Position(1), q, r, 0.1)
    assert result.status.tolist() == [Status.OK, Status.NOT_FINITE]
    assert 0 < int(result.failed_step[1]) < 20


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_collapse_gets_a_status(form):
    def trap(x, dt):
        del dt
        return torch.where(x[:, :1] > 5.0, 7.0, x)

    start = torch.tensor([[1.0, 1.0], [9.0, 9.0]], dtype=F64)
    rows = torch.ones(2, 5, 1, dtype=F64)
    belief = initial_belief(start, 1e-4 * torch.eye(2))
    result = unscented_filter(
        trap, belief, rows, Position(1), torch.zeros(2, 2), torch.eye(1), 0.1, form=form
    )
    assert result.status.tolist() == [Status.OK, Status.COLLAPSED]
    assert result.failed_step.tolist() == [-1, 0]


def test_exact_measurements_of_the_same_thing_twice_are_singular():
    class Twice(Position):
        def __call__(self, x, t):
            del t
            return x[..., :1].expand(*x.shape[:-1], 2)

    rows = torch.ones(1, 3, 2, dtype=F64)
    belief = initial_belief(torch.ones(1, 2, dtype=F64), torch.eye(2))
    result = unscented_filter(duffing, belief, rows, Twice(2), 1e-3 * torch.eye(2), torch.zeros(2, 2), 0.1)
    assert result.status.tolist() == [Status.COLLAPSED]


def test_runs_under_inference_mode_and_keeps_no_graph():
    weight = torch.eye(2, dtype=F64, requires_grad=True)
    _, _, result = duffing_run(flow=lambda x, dt: duffing(x, dt) @ weight)
    assert not result.means.requires_grad
    with torch.inference_mode():
        _, _, again = duffing_run(parameters=UnscentedParameters())
    assert torch.equal(result.means, again.means)


def test_a_pass_through_south_does_not_upset_the_filter():
    # The satellite stands due south: its sigma points straddle the cut of the azimuth.
    station = GroundStation(math.degrees(0.7), 0.0, rotation_rate=0.0)
    north, up = ((-math.sin(0.7), 0.0, math.cos(0.7)), (math.cos(0.7), 0.0, math.sin(0.7)))
    site = torch.tensor([station.equatorial, 0.0, station.polar], dtype=F64)
    q = site + 800.0 * (torch.tensor(up, dtype=F64) - torch.tensor(north, dtype=F64))
    x = torch.cat((q, torch.zeros(3, dtype=F64)))[None]
    rows = station(x, 0.0)[:, None].repeat(1, 5, 1)
    rows[:, 1::2, 1] *= -1.0
    r = torch.diag(torch.tensor([1e-2, 1e-8, 1e-8], dtype=F64))
    p0 = torch.diag(torch.tensor([1.0] * 3 + [1e-6] * 3, dtype=F64))
    belief = initial_belief(x + 0.3, p0)
    result = unscented_filter(lambda x, _: x * 1.0, belief, rows, station, 1e-9 * torch.eye(6), r, 1.0)
    assert float((result.means[0, -1, :3] - x[0, :3]).norm()) < 0.5
    assert bool((result.innovations[..., 1].abs() < 0.01).all())


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_a_variance_that_overflows_while_the_mean_does_not_gets_a_status(form):
    belief = initial_belief(torch.zeros(2, 2, dtype=F64), torch.eye(2))
    rows = torch.full((2, 1, 1), torch.nan, dtype=F64)
    stretch = torch.tensor([1.0, 1e170], dtype=F64).repeat_interleave(5).unsqueeze(-1)
    result = unscented_filter(
        lambda x, _: stretch * x, belief, rows, Position(1), 1e-8 * torch.eye(2), torch.eye(1), 0.1, form=form
    )
    assert result.status.tolist() == [Status.OK, Status.NOT_FINITE]


def test_the_numbers_of_a_status_stand_in_stored_states():
    names = ("OK", "NOT_FINITE", "COLLAPSED", "DIVERGED", "IMPRECISE")
    assert {status.name: status.value for status in Status} == dict(zip(names, range(5), strict=True))


@pytest.mark.parametrize("part", ["mean", "chol", "nis"])
def test_an_update_of_which_any_part_is_not_finite_ends_its_member_alone(part):
    def spoil(*arguments):
        updated = SQUARE_ROOT.update(*arguments)._replace(sound=False)  # as of a form that does not look
        if part == "nis":
            return updated._replace(nis=updated.nis.clone().index_fill_(0, torch.tensor([1]), torch.inf))
        spoilt = getattr(updated.belief, part).clone()
        spoilt[1, 1] = torch.inf
        return updated._replace(belief=updated.belief._replace(**{part: spoilt}))

    belief = initial_belief(torch.zeros(3, 2, dtype=F64), torch.eye(2))
    rows = torch.ones(3, 1, 1, dtype=F64)
    noise = 0.01 * torch.eye(2), torch.eye(1)
    form = SQUARE_ROOT._replace(read=None, update=spoil)
    result = unscented_filter(lambda x, _: 1.0 * x, belief, rows, Position(1), *noise, 1.0, form=form)
    assert result.status.tolist() == [Status.OK, Status.NOT_FINITE, Status.OK]

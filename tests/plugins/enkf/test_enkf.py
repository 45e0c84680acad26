"""The ensemble Kalman filter: exact where it can be, 1/sqrt(N) where it draws, one member never another's."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import torch
from sample_filters import (
    F64,
    NAN,
    P0,
    H,
    Linear,
    R,
    draw,
    kalman,
    linear_problem,
    same,
    spring_nees,
    steps_of,
)

from ahnn.errors import UserError
from ahnn.estimation import (
    Gate,
    Status,
    initial_belief,
    load_state,
    save_state,
)
from ahnn.estimation.consistency import band
from ahnn.measurements import Position
from ahnn_plugins.ekf import ExtendedKalmanFilter
from ahnn_plugins.enkf import EnsembleKalmanFilter

SQUARE, DRAWN = EnsembleKalmanFilter(ensemble=20), EnsembleKalmanFilter(ensemble=20, form="stochastic")


@pytest.mark.parametrize(("q", "ensemble"), [(0.0, 4), (0.02, 7), (0.02, 100)])
def test_the_square_root_form_is_the_kalman_filter_on_a_linear_system(q, ensemble):
    """Even with D + 1 members without process noise, and 2 D + 1 with it."""
    problem = linear_problem(q)
    result = EnsembleKalmanFilter(ensemble=ensemble).run(*problem)
    means, covariances, likelihoods = kalman(q, problem[2], problem[1].mean)
    torch.testing.assert_close(result.means, means, rtol=1e-9, atol=1e-10)
    torch.testing.assert_close(result.covariances, covariances, rtol=1e-9, atol=1e-10)
    torch.testing.assert_close(result.log_likelihood, likelihoods, rtol=1e-10, atol=0.0)


def errors(form, ensemble, seeds=6):
    """Rms distance of means from those of the Kalman filter, in its standard deviations."""
    q = 0.02
    problem = linear_problem(q, steps=12)
    means, covariances, _ = kalman(q, problem[2], problem[1].mean)
    sd = covariances.diagonal(dim1=-2, dim2=-1).sqrt()
    squares = []
    for seed in range(seeds):
        result = EnsembleKalmanFilter(ensemble=ensemble, form=form, seed=seed).run(*problem)
        squares.append(((result.means - means) / sd).square().mean())
    return float(torch.stack(squares).mean().sqrt())


def test_the_stochastic_form_converges_with_the_root_of_the_members():
    found = [errors("stochastic", n) for n in (50, 450, 4050)]
    assert found[0] < 0.5
    for coarse, fine in pairwise(found):
        assert 2.0 < coarse / fine < 4.5  # 3 expected


@pytest.mark.parametrize("form", ["square_root", "stochastic"])
def test_an_update_is_the_kalman_update_of_the_ensemble(form):
    """Mean and, without drawing, covariance; a number that is missing tells nothing."""
    enkf = EnsembleKalmanFilter(ensemble=9, form=form)
    state = enkf.start(initial_belief(draw(2, 3), P0))
    state = enkf.predict(state, lambda x, _: x + 0.3 * torch.sin(x), 0.1, 0.1 * torch.eye(3, dtype=F64))
    y = torch.tensor([[0.5, -0.2], [NAN, 1.0]], dtype=F64)
    after, told = enkf.update(state, y, Linear(), R)
    for b, there in enumerate(~y.isnan()):
        x, h, r = state.points[b], H[there], R[there][:, there]
        p, m = x.mT.cov(), x.mean(0)
        s = h @ p @ h.mT + r
        gain, off = p @ h.mT @ torch.linalg.inv(s), y[b][there] - h @ m
        torch.testing.assert_close(after.points[b].mean(0), m + gain @ off, rtol=1e-10, atol=1e-12)
        assert float(told.nis[b]) == pytest.approx(float(off @ torch.linalg.solve(s, off)), rel=1e-10)
        if form == "square_root":
            expected = (torch.eye(3, dtype=F64) - gain @ h) @ p
            torch.testing.assert_close(after.points[b].mT.cov(), expected, rtol=1e-10, atol=1e-12)


def test_inflation_widens_what_an_update_sees():
    plain, wide = (EnsembleKalmanFilter(ensemble=9, inflation=f) for f in (1.0, 1.5))
    start = initial_belief(torch.zeros(1, 3), P0)
    row = torch.tensor([[3.0, NAN]], dtype=F64)
    told = [f.update(f.start(start), row, Linear(), R)[1] for f in (plain, wide)]
    s = (H @ P0 @ H.mT)[0, 0]
    for factor, found in zip((1.0, 2.25), told, strict=True):
        assert float(found.nis) == pytest.approx(9.0 / float(factor * s + R[0, 0]), rel=1e-10)


@pytest.mark.parametrize("enkf", [SQUARE, DRAWN])
def test_what_happens_to_one_member_is_nothing_to_another(enkf):
    flow, belief, rows, *rest = linear_problem(0.02)
    alone = enkf.run(flow, type(belief)(*(part[:1] for part in belief)), rows[:1], *rest)
    spoiled = rows.clone()
    spoiled[1] = torch.nan

    def broken(x, dt):
        after = flow(x, dt)
        return torch.where(torch.arange(len(x))[:, None] == 25, torch.nan, after)  # of member 1

    for other in (enkf.run(flow, belief, spoiled, *rest), enkf.run(broken, belief, rows, *rest)):
        torch.testing.assert_close(other.means[:1], alone.means, rtol=1e-12, atol=1e-13)
    assert other.status.tolist() == [Status.OK, Status.NOT_FINITE]
    assert other.failed_step.tolist() == [-1, 0]


@pytest.mark.parametrize("enkf", [SQUARE, DRAWN])
def test_steps_are_the_run_and_a_restored_state_goes_on_bit_for_bit(enkf, tmp_path):
    flow, belief, rows, *rest = linear_problem(0.02)
    whole = enkf.run(flow, belief, rows, *rest)
    begin = enkf.start(belief)
    for k, state in enumerate(steps_of(enkf, begin, flow, rows, *rest)):
        if k in (6, 7, 20):
            save_state(state, tmp_path / "a.state")
            kept = load_state(tmp_path / "a.state", like=begin)
            assert same(kept, state)
            assert same(enkf.run(flow, kept, rows[:, k + 1 :], *rest).state, whole.state)
    assert same(state, whole.state)
    other = EnsembleKalmanFilter(ensemble=20, form=enkf.form, seed=1).run(flow, belief, rows, *rest)
    assert not torch.equal(other.means, whole.means)
    with pytest.raises(ValueError, match="path: expected a file written by save_state"):
        load_state(tmp_path / "a.state", like=ExtendedKalmanFilter().start(belief))


@pytest.mark.parametrize("form", ["square_root", "stochastic"])
def test_it_is_consistent_on_a_spring(form):
    values, status = spring_nees(EnsembleKalmanFilter(ensemble=200, form=form), 50)
    assert not bool(status.any())
    low, high = band(2, 50, 0.999)
    assert low < float(values[:, -1].mean()) < high


def test_its_smoother_is_that_of_the_kalman_filter_on_a_linear_system():
    problem = linear_problem(0.02)
    found = []
    for chosen in (SQUARE, ExtendedKalmanFilter()):
        result = chosen.run(*problem, smoothing=True)
        found.append(chosen.smoothers["smoothed"](result, None).beliefs)  # pyright: ignore
    for ours, theirs in zip(found[0][:3], found[1][:3], strict=True):
        if not isinstance(ours, torch.Tensor):
            ours, theirs = ours.mean, theirs.mean
        torch.testing.assert_close(ours, theirs, rtol=1e-8, atol=1e-9)


def test_its_gate_ends_a_member_that_refuses_too_much():
    rows = torch.full((2, 6, 1), 0.5, dtype=F64)
    rows[1, 2:] = 100.0
    belief = initial_belief([[0.5, 0.0]] * 2, 0.01 * np.eye(2))
    options = (Position(1), 1e-8 * np.eye(2), [[1e-2]], 0.1)
    result = SQUARE.gated(Gate(0.999, 3)).run(lambda x, _: x, belief, rows, *options)
    assert result.status.tolist() == [Status.OK, Status.DIVERGED]
    assert result.failed_step.tolist() == [-1, 4]
    assert result.rejected[1].tolist() == [False, False, True, True, True, False]


WRONG = {
    "ensemble: expected a whole number >= 2; received 1": {"ensemble": 1},
    "form: expected one of stochastic, square_root; received 'other'": {"form": "other"},
    "inflation: expected a number >= 1; received 0.9": {"inflation": 0.9},
    "seed: expected a whole number from 0": {"seed": -1},
    "gate: expected a Gate": {"gate": 0.9},
    "localisation: unknown key 'width'": {"localisation": {"width": 3}},
    "localisation.radius: expected float > 0": {"localisation": {"radius": 0, "coordinates": 3}},
}


@pytest.mark.parametrize("message", WRONG)
def test_values_beyond_their_limits_are_refused(message):
    with pytest.raises(ValueError, match=message):
        EnsembleKalmanFilter(**WRONG[message])


def test_fewer_members_than_components_are_refused():
    with pytest.raises(UserError, match="ensemble: expected more members than the 3 estimated components"):
        EnsembleKalmanFilter(ensemble=3).start(initial_belief(torch.zeros(1, 3), P0))
    with pytest.raises(UserError, match="state: expected a SampleState"):
        SQUARE.predict(ExtendedKalmanFilter().start(initial_belief(torch.zeros(1, 3), P0)), *[None] * 3)  # pyright: ignore

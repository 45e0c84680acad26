"""Interacting models: filterpy's on linear systems to rounding, manoeuvres, known flows, saved states."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from filterpy.kalman import IMMEstimator, KalmanFilter
from sample_filters import F64, NAN, P0, A, H, Linear, R, draw, linear, linear_problem, same, steps_of

from ahnn.estimation import Gate, Status, initial_belief, load_state, save_state
from ahnn.measurements import Position
from ahnn.systems import Pendulum, exact_flow
from ahnn_plugins.ekf import ExtendedKalmanFilter
from ahnn_plugins.imm import InteractingModels, MotionMode
from ahnn_plugins.imm.mixture import mixing, mixture_moments
from ahnn_plugins.ukf import STANDARD, UnscentedKalmanFilter

UKF = UnscentedKalmanFilter()
TWO = InteractingModels(UKF, ({"factor": 1.0}, {"factor": 4.0}), 0.5)
SWING = Pendulum(name="swing", dt=0.1, steps=60)


def exponential(rates):
    """The exponential of a small matrix by its series."""
    total = term = np.eye(len(rates))
    for k in range(1, 40):
        term = term @ rates / k
        total = total + term
    return total


def filterpy_models(factors, dwell, dt, q, mean, rows):
    """Means, covariances, mode probabilities and log-likelihood of one member, by filterpy."""
    count = len(factors)
    filters = []
    for factor in factors:
        kf = KalmanFilter(3, 2)
        kf.x, kf.P, kf.F, kf.H = mean.numpy()[:, None].copy(), P0.numpy().copy(), A.numpy(), H.numpy()
        kf.Q, kf.R = factor**2 * q * np.eye(3), R.numpy()
        filters.append(kf)
    rates = np.array(
        [[-1.0 / t if i == j else 1.0 / t / (count - 1) for j in range(count)] for i, t in enumerate(dwell)]
    )
    imm = IMMEstimator(filters, np.array(dwell), exponential(rates * dt))
    found, told = [], 0.0
    for row in rows.numpy():
        imm.predict()
        before = imm.cbar.copy()
        imm.update(row[:, None])
        told += math.log(float(np.sum(before * imm.likelihood)))
        found.append((imm.x[:, 0].copy(), imm.P.copy(), imm.mu.copy()))
    return *(np.stack(part) for part in zip(*found, strict=True)), told


@pytest.mark.parametrize("inner", [UKF, UnscentedKalmanFilter(form=STANDARD), ExtendedKalmanFilter()])
@pytest.mark.parametrize(
    ("factors", "dwell"), [((1.0, 4.0), (0.5, 0.25)), ((1.0, 0.0, 9.0), (1.0, 2.0, 0.3))]
)
def test_on_a_linear_system_it_is_the_one_of_filterpy(inner, factors, dwell):
    q = 0.01
    flow, belief, rows, *rest, dt = linear_problem(q, steps=12)
    rows = torch.where(rows.isnan(), 0.5, rows)  # filterpy takes whole rows alone
    imm = InteractingModels(inner, tuple({"factor": f} for f in factors), dwell)
    modes, means, covariances = [], [], []
    for state in steps_of(imm, imm.start(belief), flow, rows, *rest, dt):
        modes.append(state.probabilities)
        means.append(state.belief.mean)
        covariances.append(state.belief.covariance)
    for b in range(2):
        x, p, mu, told = filterpy_models(factors, dwell, dt, q, belief.mean[b], rows[b])
        np.testing.assert_allclose(torch.stack(means, 1)[b], x, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(torch.stack(covariances, 1)[b], p, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(torch.stack(modes, 1)[b], mu, rtol=1e-9, atol=1e-14)
        assert float(state.log_likelihood[b]) == pytest.approx(told, rel=1e-10)


def test_modes_that_are_alike_are_the_filter_itself():
    problem = linear_problem(0.1)
    one = UKF.run(*problem)
    both = InteractingModels(UKF, ({}, {}, {}), 1.0).run(*problem)
    for name in ("means", "covariances", "predicted_means", "innovations", "nis", "log_likelihood"):
        torch.testing.assert_close(
            getattr(both, name), getattr(one, name), rtol=1e-9, atol=1e-11, equal_nan=True
        )


def test_the_chain_is_one_in_continuous_time():
    log_modes, dwell = torch.tensor([[0.9, 0.1], [0.2, 0.8]], dtype=F64).log(), torch.tensor([3.0, 3.0])
    dwell = dwell.double()
    whole = mixing(log_modes, dwell, 0.7)
    stays = 0.5 * (1 + math.exp(-2 * 0.7 / 3.0))  # of two modes with rates 1/3
    expected = 0.9 * stays + 0.1 * (1 - stays)
    assert float(whole.log_modes[0, 0].exp()) == pytest.approx(expected, rel=1e-12)
    assert float(whole.origins[0, 0, 0]) == pytest.approx(0.9 * stays / expected, rel=1e-12)
    halves = mixing(mixing(log_modes, dwell, 0.35).log_modes, dwell, 0.35)
    torch.testing.assert_close(halves.log_modes, whole.log_modes, rtol=1e-12, atol=0)
    long = mixing(log_modes, torch.tensor([1.0, 3.0], dtype=F64), 1e3)
    torch.testing.assert_close(long.log_modes.exp(), torch.tensor([[0.25, 0.75]] * 2, dtype=F64))


def test_moments_are_those_of_a_sample_of_the_mixture():
    means, weights = draw(1, 3, 2), torch.tensor([[0.2, 0.5, 0.3]], dtype=F64)
    chols = torch.stack([torch.linalg.cholesky(torch.eye(2, dtype=F64) * s + 0.3) for s in (1, 2, 3)])[None]
    found = mixture_moments(means, chols, weights)
    mean = sum(w * m for w, m in zip(weights[0], means[0], strict=True))
    second = sum(
        w * (c @ c.mT + torch.outer(m, m)) for w, m, c in zip(weights[0], means[0], chols[0], strict=True)
    )
    torch.testing.assert_close(found.mean[0], mean)
    torch.testing.assert_close(found.covariance[0], second - torch.outer(mean, mean))


def manoeuvre():
    """A particle on a line whose velocity jumps halfway, as its positions say: truth and rows."""
    velocity = torch.where(torch.arange(60) < 30, 0.0, 0.5).double()
    truth = (0.1 * velocity).cumsum(0).repeat(20, 1)
    return truth, truth.unsqueeze(-1) + 0.05 * draw(20, 60, 1, seed=5)


def coasting(x, dt):
    return torch.stack((x[:, 0] + dt * x[:, 1], x[:, 1]), -1)


def test_a_manoeuvre_is_followed_and_told_from_quiet():
    truth, rows = manoeuvre()
    belief = initial_belief(torch.zeros(20, 2), 1e-4 * np.eye(2))
    rest = Position(1), 1e-8 * np.eye(2), [[0.05**2]], 0.1
    modes = MotionMode(), MotionMode(added=[0.0, 1.0])
    imm = InteractingModels(UKF, modes, (20.0, 1.0))
    error = {}
    for name, one in {"imm": imm, "quiet": UKF}.items():
        result = one.run(coasting, belief, rows, *rest)
        assert not bool(result.status.any())
        error[name] = (result.means[..., 0] - truth).square().mean(0).sqrt()
    noisy = UKF.run(coasting, belief, rows, Position(1), np.diag([1e-8, 0.1]), *rest[2:])
    error["noisy"] = (noisy.means[..., 0] - truth).square().mean(0).sqrt()
    assert float(error["imm"][35:].mean()) < 0.2 * float(error["quiet"][35:].mean())  # it follows
    assert float(error["imm"][10:30].mean()) < 0.6 * float(error["noisy"][10:30].mean())  # it rests before
    seen = [
        float(s.probabilities[:, 1].mean()) for s in steps_of(imm, imm.start(belief), coasting, rows, *rest)
    ]
    assert max(seen[10:30]) < 0.2 < 0.5 < max(seen[30:40])


def test_a_known_flow_beside_a_wrong_one_is_found():
    flow, wrong = exact_flow(SWING), exact_flow(replace(SWING, gravity=8.0))
    x, rows = torch.tensor([[1.0, 0.0]] * 10, dtype=F64), []
    for k in range(25):
        x = flow(x, 0.1)
        rows.append(x[:, :1] + 0.02 * draw(10, 1, seed=k))
    modes = {"factor": 1.0}, {"factor": 1.0, "beside": SWING}
    imm = InteractingModels(UKF, modes, 1e4)
    belief = initial_belief(torch.tensor([[1.0, 0.0]] * 10, dtype=F64), 1e-4 * np.eye(2))
    options = torch.stack(rows, 1), Position(1), 1e-10 * np.eye(2), [[4e-4]], 0.1
    result = imm.run(wrong, belief, *options)
    assert float(result.state.probabilities[:, 1].min()) > 0.99
    known = UKF.run(flow, belief, *options)
    sd = known.covariances[:, -1].diagonal(dim1=-2, dim2=-1).sqrt()
    assert float(((result.means - known.means)[:, -1] / sd).square().mean().sqrt()) < 0.1
    assert UKF.run(wrong, belief, *options).log_likelihood.sum() < result.log_likelihood.sum() - 50


def test_steps_are_the_run_and_a_restored_state_goes_on_bit_for_bit(tmp_path):
    flow, belief, rows, *rest = linear_problem(0.1, steps=12)
    whole, begin = TWO.run(flow, belief, rows, *rest), TWO.start(belief)
    for k, state in enumerate(steps_of(TWO, begin, flow, rows, *rest)):
        if k in (4, 7):
            save_state(state, tmp_path / "a.state")
            kept = load_state(tmp_path / "a.state", like=begin)
            after = TWO.run(flow, kept, rows[:, k + 1 :], *rest).state
            assert same(after, whole.state)
    assert same(state, whole.state)


def test_members_do_not_see_one_another_and_a_lost_one_is_frozen():
    flow, belief, rows, *rest = linear_problem(0.1, steps=6)

    def broken(x, dt):
        return torch.where((torch.arange(len(x)) >= len(x) // 2)[:, None], torch.nan, flow(x, dt))

    whole = TWO.run(broken, belief, rows, *rest)
    assert whole.status.tolist() == [Status.OK, Status.NOT_FINITE]
    assert whole.state.belief.mean[1].tolist() == belief.mean[1].tolist()
    alone = TWO.run(flow, type(belief)(*(part[:1] for part in belief)), rows[:1], *rest)
    torch.testing.assert_close(whole.means[:1], alone.means, rtol=1e-12, atol=1e-13)


def test_a_row_of_nothing_changes_nothing_and_a_gate_refuses_an_outlier():
    gated = TWO.gated(Gate(0.9999, 3))
    state = gated.predict(gated.start(initial_belief(torch.zeros(2, 3), P0)), linear, 0.1, 0.01 * P0)
    after, told = gated.update(state, [[NAN, NAN], [300.0, 0.0]], Linear(), R)
    assert told.rejected.tolist() == [False, True]
    assert torch.equal(after.mode_means, state.mode_means)
    assert torch.equal(after.log_modes, state.log_modes)
    assert float(told.log_likelihood[1]) == 0.0


WRONG = {
    "filter: expected a Gaussian filter": {"filter": 1},
    "modes: expected at least two; received 1": {"modes": ({},)},
    "modes.1.factor: expected float >= 0; received -1": {"modes": ({}, {"factor": -1.0})},
    "modes.0: unknown key 'noise'": {"modes": ({"noise": 1.0}, {})},
    "dwell: expected a time > 0, or 2 times; received 0.0": {"dwell": 0.0},
    r"dwell: expected a time > 0, or 2 times; received \(1.0,\)": {"dwell": (1.0,)},
}


@pytest.mark.parametrize("message", WRONG)
def test_values_beyond_their_limits_are_refused(message):
    with pytest.raises(ValueError, match=message):
        InteractingModels(**{"filter": UKF, **WRONG[message]})


def test_modes_that_do_not_fit_a_state_are_refused():
    belief = initial_belief(torch.zeros(1, 3), P0)
    with pytest.raises(ValueError, match=r"modes\.0\.added: expected at most 3 standard deviations"):
        InteractingModels(UKF, ({"added": [0.0] * 4}, {})).start(belief)
    with pytest.raises(ValueError, match=r"modes\.1\.beside: expected a system with 3 components"):
        InteractingModels(UKF, ({}, {"beside": SWING})).start(belief)

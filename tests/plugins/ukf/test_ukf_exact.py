"""The filter against exact and independent oracles: the Kalman filter, and filterpy."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from ahnn.estimation import initial_belief
from ahnn_plugins.ukf import SQUARE_ROOT, STANDARD, UnscentedParameters, unscented_filter
from ahnn_plugins.ukf.sigma_points import draw, unscented_weights

FORMS = [SQUARE_ROOT, STANDARD]


def kalman_filter(problem, b):
    """Textbook Kalman filter of member b; the gain form of the update, symmetrised."""
    a, h, q, r = (m.numpy() for m in (problem.a, problem.h, problem.q, problem.r))
    mean, cov = problem.mean[b].numpy(), problem.p0.numpy()
    means, covs, log_likelihood = [], [], 0.0
    for y in problem.measurements[b].numpy():
        mean, cov = a @ mean, a @ cov @ a.T + q
        s = h @ cov @ h.T + r
        gain = np.linalg.solve(s, h @ cov).T
        nu = y - h @ mean
        log_likelihood -= 0.5 * (nu @ np.linalg.solve(s, nu) + np.linalg.slogdet(2 * np.pi * s)[1])
        mean = mean + gain @ nu
        keep = np.eye(len(mean)) - gain @ h
        cov = keep @ cov @ keep.T + gain @ r @ gain.T
        means.append(mean)
        covs.append(cov)
    return torch.from_numpy(np.stack(means)), torch.from_numpy(np.stack(covs)), log_likelihood


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
@pytest.mark.parametrize(("size", "width"), [(2, 1), (3, 2), (4, 4), (6, 3), (8, 5)])
@pytest.mark.sampled(3)
def test_equals_the_kalman_filter(make_linear, close, form, size, width):
    problem, model = make_linear(size, width, steps=400, batch=2, seed=size)
    belief = initial_belief(problem.mean, problem.p0)
    result = unscented_filter(
        problem.flow, belief, problem.measurements, model, problem.q, problem.r, 1.0, form=form
    )
    for b in range(2):
        means, covs, log_likelihood = kalman_filter(problem, b)
        assert close(result.means[b], means, 1e-10)
        assert close(result.covariances[b], covs, 1e-10, trailing=2)
        assert float(result.log_likelihood[b]) == pytest.approx(log_likelihood, rel=1e-10)
    assert result.status.tolist() == result.repairs.tolist() == [0, 0]
    # The process noise must matter, else stale sigma points would pass.
    assert problem.q.trace() > 0.1 * result.covariances[0, -1].trace()


def pendulum(x, dt):
    """Damped, driven pendulum, one step of semi-implicit Euler; works for tensors (N, 2)."""
    p = x[:, 1] - dt * (torch.sin(x[:, 0]) + 0.1 * x[:, 1])
    return torch.stack((x[:, 0] + dt * p, p), dim=-1)


class SineMeasurement:
    names = ("sine", "square")
    units = ("1", "1")

    def __call__(self, x, t):
        del t
        return torch.stack((torch.sin(x[..., 0]), x[..., 1] ** 2 + x[..., 0]), dim=-1)

    def residual(self, y, y_pred):
        return y - y_pred


def pendulum_data(batch, steps, seed=0):
    generator = torch.Generator().manual_seed(seed)
    noise = 0.05 * torch.randn(batch, steps, 2, generator=generator, dtype=torch.float64)
    x = torch.tensor([[1.0, 0.0]], dtype=torch.float64).repeat(batch, 1)
    rows = []
    for _ in range(steps):
        x = pendulum(x, 0.05)
        rows.append(SineMeasurement()(x, 0.0))
    start = torch.tensor([[1.2, -0.1]], dtype=torch.float64).repeat(batch, 1)
    return start, torch.stack(rows, 1) + noise


PENDULUM_NOISE = 1e-4 * torch.tensor([[2.0, 0.5], [0.5, 1.0]], dtype=torch.float64), 0.0025 * torch.eye(2)


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
@pytest.mark.parametrize("parameters", [(1.0, 2.0, 0.0), (0.3, 2.0, 1.0), (0.7, 0.0, 0.5)])
@pytest.mark.sampled(2)
def test_equals_filterpy_on_a_nonlinear_problem(close, form, parameters):
    start, rows = pendulum_data(batch=1, steps=500)
    q, r = (m.to(torch.float64) for m in PENDULUM_NOISE)
    p0 = 0.05 * torch.eye(2, dtype=torch.float64)
    model = SineMeasurement()
    ukf = UnscentedKalmanFilter(
        2,
        2,
        0.05,
        hx=lambda x: model(torch.from_numpy(x), 0.0).numpy(),
        fx=lambda x, dt: pendulum(torch.from_numpy(x)[None], dt)[0].numpy(),
        points=MerweScaledSigmaPoints(2, *parameters),
    )
    ukf.x, ukf.P, ukf.Q, ukf.R = start[0].numpy(), p0.numpy(), q.numpy(), r.numpy()
    means, covs = [], []
    for y in rows[0].numpy():
        ukf.predict()
        ukf.update(y)
        means.append(ukf.x.copy())
        covs.append(ukf.P.copy())
    result = unscented_filter(
        pendulum,
        initial_belief(start, p0),
        rows,
        model,
        q,
        r,
        0.05,
        parameters=UnscentedParameters(*parameters),
        form=form,
    )
    assert close(result.means[0], torch.from_numpy(np.stack(means)), 1e-9)
    assert close(result.covariances[0], torch.from_numpy(np.stack(covs)), 1e-9, trailing=2)


@pytest.mark.parametrize(
    "parameters", [(1e-3, 2.0, 0.0), (0.1, 0.0, 0.0), (1.0, 0.0, -1.0)], ids=["small", "flat", "downdate"]
)
def test_forms_agree_with_a_negative_centre_weight(close, parameters):
    start, rows = pendulum_data(batch=2, steps=300)
    weights = unscented_weights(UnscentedParameters(*parameters), 2)
    assert float(weights.covariance_centre) < 0.0
    assert (weights.downdate is not None) == (parameters[2] < 0.0)
    belief = initial_belief(start, 0.05 * torch.eye(2))
    results = [
        unscented_filter(
            pendulum,
            belief,
            rows,
            SineMeasurement(),
            *PENDULUM_NOISE,
            0.05,
            parameters=UnscentedParameters(*parameters),
            form=form,
        )
        for form in FORMS
    ]
    # alpha = 1e-3 costs the textbook sums some six digits.
    assert close(results[0].means, results[1].means, 1e-8)
    assert close(results[0].covariances, results[1].covariances, 1e-7, trailing=2)
    for result in results:
        assert result.status.tolist() == result.repairs.tolist() == [0, 0]


@pytest.mark.parametrize("alpha", [1e-3, 0.1, 1.0])
@pytest.mark.parametrize("kappa", [-1.5, 0.0, 3.0])
def test_weights_and_points_have_the_moments_of_the_belief(close, alpha, kappa):
    generator = torch.Generator().manual_seed(1)
    root = torch.randn(3, 4, 4, generator=generator, dtype=torch.float64)
    mean = torch.randn(3, 4, generator=generator, dtype=torch.float64)
    belief = initial_belief(mean, root @ root.mT + torch.eye(4))
    weights = unscented_weights(UnscentedParameters(alpha, 2.0, kappa), 4)
    points = draw(belief, weights)
    mean_weights = torch.full((9,), float(weights.outer), dtype=torch.float64)
    mean_weights[0] = float(weights.mean_centre)
    assert float(mean_weights.sum()) == pytest.approx(1.0, abs=1e-9)
    deviations = points - belief.mean.unsqueeze(1)
    covariance = float(weights.outer) * deviations[:, 1:].mT @ deviations[:, 1:]
    assert close(covariance, belief.covariance, 1e-9, trailing=2)


def test_parameters_per_member_equal_runs_with_one_value(close):
    start, rows = pendulum_data(batch=3, steps=50)
    belief = initial_belief(start, 0.05 * torch.eye(2))
    alphas = torch.tensor([0.1, 0.5, 1.0], dtype=torch.float64)
    scales = torch.tensor([0.5, 1.0, 2.0], dtype=torch.float64)[:, None, None]
    q, r = PENDULUM_NOISE
    both = unscented_filter(
        pendulum,
        belief,
        rows,
        SineMeasurement(),
        q * scales,
        r * scales,
        0.05,
        parameters=UnscentedParameters(alphas),
    )
    for b in range(3):
        one = unscented_filter(
            pendulum,
            initial_belief(start[b : b + 1], 0.05 * torch.eye(2)),
            rows[b : b + 1],
            SineMeasurement(),
            q * scales[b],
            r * scales[b],
            0.05,
            parameters=UnscentedParameters(float(alphas[b])),
        )
        assert close(both.means[b], one.means[0], 1e-12)

"""Sigma points that lie too close together for float64: equal to the Kalman filter, or said so."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from ahnn.estimation import Status, initial_belief
from ahnn.measurements import State
from ahnn_plugins.ukf import SQUARE_ROOT, STANDARD, UnscentedParameters, unscented_filter

FORMS = [SQUARE_ROOT, STANDARD]
TOLERANCE = 0.02
"""Of a mean in standard deviations, and of a covariance relative to them, over 20 steps at most 1e-3 each."""


def kalman(problem):
    """Means and covariances of the textbook Kalman filter of member 0 after each update."""
    a, h, q, r = (m.numpy() for m in (problem.a, problem.h, problem.q, problem.r))
    mean, cov, means, covs = problem.mean[0].numpy(), problem.p0.numpy(), [], []
    for y in problem.measurements[0].numpy():
        mean, cov = a @ mean, a @ cov @ a.T + q
        gain = np.linalg.solve(h @ cov @ h.T + r, h @ cov).T
        keep = np.eye(len(mean)) - gain @ h
        mean, cov = mean + gain @ (y - h @ mean), keep @ cov @ keep.T + gain @ r @ gain.T
        means.append(mean)
        covs.append(cov)
    return torch.from_numpy(np.stack(means)), torch.from_numpy(np.stack(covs))


def worst(result, means, covs):
    """Return the largest error of a mean and of a covariance, in standard deviations."""
    deviation = torch.diagonal(covs, dim1=-2, dim2=-1).sqrt()
    of_means = ((result.means[0] - means) / deviation).abs().max()
    of_covs = ((result.covariances[0] - covs) / (deviation[:, :, None] * deviation[:, None])).abs().max()
    return max(float(of_means), float(of_covs))


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
@pytest.mark.parametrize("size", [2, 4, 6])
@pytest.mark.parametrize("far", [0.0, 1.0, 1e3, 1e6])
@pytest.mark.sampled(5)
def test_a_small_alpha_is_the_kalman_filter_or_gets_a_status(make_linear, form, size, far):
    problem, model = make_linear(size, 2, steps=20, seed=size)
    means, covs = kalman(problem)
    # The same problem about another origin, a few standard deviations away or many.
    offset = far * torch.ones(size, dtype=torch.float64)
    belief = initial_belief(problem.mean + offset, problem.p0)
    said = []
    for k in range(13):
        parameters = UnscentedParameters(10.0**-k)
        result = unscented_filter(
            lambda x, dt: problem.flow(x - offset, dt) + offset,
            belief,
            problem.measurements + problem.h @ offset,
            model,
            problem.q,
            problem.r,
            1.0,
            parameters=parameters,
            form=form,
        )
        if result.status.tolist() == [Status.OK]:
            assert worst(result, means + offset, covs) < TOLERANCE, k
        said.append(int(result.status[0]))
    # What is harmless goes on, and nothing goes on for nothing. The standard form may collapse first.
    harmless = 4 if far < 1e4 else 3
    assert said[:harmless] == [Status.OK] * harmless
    assert set(said[8:]) <= {Status.IMPRECISE, Status.COLLAPSED}
    assert form is STANDARD or said[-1] == Status.IMPRECISE


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_a_member_with_crowded_points_stops_alone(make_linear, form):
    problem, model = make_linear(3, 2, steps=5, batch=2, seed=1)
    alphas = torch.tensor([1e-9, 1.0], dtype=torch.float64)
    arguments = (problem.flow, initial_belief(problem.mean, problem.p0), problem.measurements, model)
    options = {"parameters": UnscentedParameters(alphas), "form": form}
    both = unscented_filter(*arguments, problem.q, problem.r, 1.0, **options)
    plain = unscented_filter(*arguments, problem.q, problem.r, 1.0, form=form)
    assert both.status.tolist() == [Status.IMPRECISE, Status.OK]
    assert both.failed_step.tolist() == [0, -1]
    assert torch.equal(both.means[1], plain.means[1])


def test_rounding_of_a_precise_measurement_gets_a_status():
    # The state is near zero, but what is measured of it is large and precise.
    class Far:
        names = units = ("far",)

        def __call__(self, x, t):
            del t
            return x[..., :1] + 1e4

        def residual(self, y, y_pred):
            return y - y_pred

    rows = torch.full((1, 1, 1), 1e4, dtype=torch.float64)
    belief = initial_belief([[0.0, 0.0]], torch.eye(2))
    for alpha, status in ((1e-2, Status.OK), (1e-5, Status.IMPRECISE)):
        result = unscented_filter(
            lambda x, _: 1.0 * x,
            belief,
            rows,
            Far(),
            0.01 * torch.eye(2),
            [[1e-4]],
            1.0,
            parameters=UnscentedParameters(alpha),
        )
        assert result.status.tolist() == [status]


def undisturbed(distance, parameters, form, members):
    """The filter of a state that rests far away, of which nothing is measured."""
    return unscented_filter(
        lambda x, _: 1.0 * x,
        initial_belief(torch.full((members, 2), distance), torch.eye(2)),
        torch.full((members, 3, 2), torch.nan),
        State(1),
        0.01 * torch.eye(2),
        torch.eye(2),
        1.0,
        parameters=parameters,
        form=form,
    )


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_predictions_alone_are_watched_and_only_those_of_crowded_points(form):
    # Both members are so far away that float64 resolves little; only for the first are its points to blame.
    alphas = torch.tensor([1e-3, 1.0], dtype=torch.float64)
    result = undisturbed(1e13, UnscentedParameters(alphas), form, members=2)
    assert result.status[0] in (Status.IMPRECISE, Status.COLLAPSED)
    assert result.status[1] == Status.OK
    near = undisturbed(1e5, UnscentedParameters(1e-5), form, members=1)
    assert near.status.tolist() == [Status.IMPRECISE]
    assert near.failed_step.tolist() == [0]

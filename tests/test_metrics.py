"""Scores agree with numpy; missing truth does not count, a lost prediction counts as infinitely wrong."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers import close, generator
from hypothesis import given, settings
from hypothesis import strategies as st

from ahnn.metrics import errors, moving_average, rmse_norm, rmse_pooled, score, typical_error


def ragged(seed, count=5, samples=9, dof=2):
    """Predictions and truths, the truth NaN beyond the end of each trajectory."""
    rng = generator(seed)
    truth = torch.randn(count, samples, 2 * dof, generator=rng, dtype=torch.float64)
    prediction = truth + torch.randn(truth.shape, generator=rng, dtype=torch.float64)
    lengths = torch.randint(1, samples + 1, (count,), generator=rng).tolist()
    for b, length in enumerate(lengths):
        truth[b, length:] = torch.nan
    return prediction, truth, lengths


@pytest.mark.parametrize("seed", range(5))
def test_both_definitions_agree_with_numpy_on_the_valid_samples(seed):
    prediction, truth, lengths = ragged(seed)
    error = errors(prediction, truth)
    rows = [(prediction[b, :n] - truth[b, :n]).numpy() for b, n in enumerate(lengths)]
    pooled = np.sqrt(np.mean(np.concatenate(rows) ** 2))
    norm = np.mean([np.sqrt(np.mean(np.sum(r**2, axis=1))) for r in rows])
    assert float(rmse_pooled(error)) == pytest.approx(pooled, rel=1e-14)
    assert float(rmse_norm(error)) == pytest.approx(norm, rel=1e-14)


def test_the_typical_error_is_a_geometric_mean_with_a_ceiling():
    error = torch.tensor([[[3.0, 4.0], [0.0, 1.0], [6.0, 8.0], [torch.nan] * 2]], dtype=torch.float64)
    assert float(typical_error(error, 1e3)) == pytest.approx((5.0 * 1.0 * 10.0) ** (1 / 3), rel=1e-14)
    error[0, 2, 0] = torch.inf
    assert float(typical_error(error, 40.0)) == pytest.approx((5.0 * 1.0 * 40.0) ** (1 / 3), rel=1e-14)
    two = torch.cat((error[:, :2], 7 * error[:, :2]))  # rms over trajectories: 5 times the first at each time
    assert float(typical_error(two, 1e3)) == pytest.approx(5 * (5.0 * 1.0) ** 0.5, rel=1e-14)


def test_it_prefers_the_model_that_stays_near_for_longer():
    steps = torch.arange(1.0, 301.0, dtype=torch.float64)
    late, early = (torch.where(steps < n, 1e-3 * steps, 1e3).reshape(1, -1, 1) for n in (200, 20))
    assert float(rmse_norm(early)) < 2 * float(rmse_norm(late))
    assert float(typical_error(late, 1e6)) < 0.01 * float(typical_error(early, 1e6))


def test_scores_are_in_velocities_and_per_component():
    prediction, truth, lengths = ragged(7)
    energies = prediction.square().sum(-1), truth.square().sum(-1)
    scores = score(prediction, truth, energies, inertia=4.0)
    rows = np.concatenate([(prediction[b, :n] - truth[b, :n]).numpy() for b, n in enumerate(lengths)])
    rows[:, 2:] /= 4.0
    assert scores.components == pytest.approx(np.sqrt((rows**2).mean(0)), rel=1e-14)
    assert scores.position_pooled == pytest.approx(np.sqrt((rows[:, :2] ** 2).mean()), rel=1e-14)
    assert scores.velocity_pooled == pytest.approx(np.sqrt((rows[:, 2:] ** 2).mean()), rel=1e-14)
    valid = ~truth.isnan().any(-1)
    energy = (energies[0] - energies[1])[valid].numpy()
    assert scores.energy == pytest.approx(np.sqrt((energy**2).mean()), rel=1e-14)
    one = score(prediction, truth, energies, inertia=1.0)
    assert scores.velocity == pytest.approx(one.velocity / 4, rel=1e-14)
    assert scores.position == one.position


@pytest.mark.parametrize("lost", [torch.nan, torch.inf, -torch.inf])
def test_a_lost_prediction_is_infinitely_wrong(lost):
    prediction, truth, _ = ragged(3)
    prediction[1, 0, 0] = lost
    scores = score(prediction, truth, (prediction.sum(-1), truth.sum(-1)), 1.0)
    assert scores.position == scores.position_pooled == scores.energy == scores.components[0] == np.inf
    assert np.isfinite(scores.velocity)
    assert np.isfinite(scores.components[1])


def test_a_prediction_that_is_lost_beyond_the_truth_does_not_count():
    prediction, truth, _ = ragged(4)
    expected = rmse_norm(errors(prediction, truth))
    prediction[truth.isnan()] = torch.inf
    assert torch.equal(rmse_norm(errors(prediction, truth)), expected)


@settings(deadline=None, max_examples=80)
@given(
    series=st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=30),
    width=st.integers(1, 40),
)
def test_the_moving_average_is_that_of_a_naive_loop(series, width):
    naive = [np.mean(series[max(0, k - width + 1) : k + 1]) for k in range(len(series))]
    got = moving_average(torch.tensor(series, dtype=torch.float64), width)
    assert np.allclose(got, naive, rtol=0, atol=1e-10)


def test_the_moving_average_ends_with_its_values():
    gap, end = torch.tensor([1.0, np.nan, 3.0, np.nan, np.nan], dtype=torch.float64), np.nan
    expected = torch.tensor([1.0, 1.0, 2.0, end, end], dtype=torch.float64)
    assert torch.equal(moving_average(gap, 4).nan_to_num(-1), expected.nan_to_num(-1))


def test_the_moving_average_of_a_constant_is_the_constant():
    series = torch.full((500,), 3.0, dtype=torch.float64)
    close(moving_average(series, 240), series, 1e-14)

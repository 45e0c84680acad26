"""Derivatives of samples and their doubts, against closed forms of circles, powers and patterns."""

from __future__ import annotations

import numpy as np
import pytest

from ahnn.data.doctor.slopes import over, roughness, slopes


def circle(angle, count=9):
    """Samples of a unit circle that are so far apart, at times that count the radians."""
    t = angle * np.arange(count)
    return t, np.stack((np.cos(t), np.sin(t)), axis=1)


@pytest.mark.parametrize("angle", [0.2, 1.0, 1.7])
@pytest.mark.parametrize("order", [1, 2])
def test_stencils_of_a_circle_have_closed_forms(angle, order):
    """Of three points sin h / h and (2 - 2 cos h) / h^2, of five (8 sin h - sin 2h) / 6h and so on."""
    found, c = slopes(*circle(angle), order), np.cos(angle)
    five = np.sin(angle) * (4 - c) / (3 * angle) if order == 1 else (7 - c) * (1 - c) / (3 * angle**2)
    assert found.at.tolist() == [2, 3, 4, 5, 6]
    assert np.linalg.norm(found.values, axis=1) == pytest.approx(five, rel=1e-9)
    assert found.doubt == pytest.approx((1 - c) / (4 - c if order == 1 else 7 - c), rel=1e-9)


def test_the_doubt_is_that_of_the_samples_whose_derivative_is_known():
    t, values = circle(1.0, 30)
    values[12, 0] = np.nan
    found = over(t, values, 1, 2)
    known = np.isfinite(found.doubts).all(1)
    assert found.at[~known].tolist() == [10, 11, 12, 13, 14]
    assert found.doubt == pytest.approx((1 - np.cos(1.0)) / (7 - np.cos(1.0)), rel=1e-9)
    assert over(t, np.nan * values, 1, 2).doubt == np.inf
    assert over(t, np.zeros((30, 2)), 1, 2).doubt == np.inf


@pytest.mark.parametrize("count", [6, 7])
def test_derivatives_take_seven_samples(count):
    assert (slopes(*circle(0.2, count), 1) is None) == (count == 6)


@pytest.mark.parametrize("power", range(1, 12))
@pytest.mark.parametrize("short", [0, 1])
def test_a_stride_leaves_twelve_derivatives(power, short):
    """Noise that comes again after so many samples is gone from differences over as many, and no others."""
    stride = 2**power
    t = np.arange(4 * stride + 12.0 - short)
    noise = np.random.default_rng(power).standard_normal(stride)
    noise = noise + np.where(np.arange(stride) < stride // 2, 3.0, -3.0)
    values = (t / stride) ** 2 + noise[t.astype(int) % stride]
    found = slopes(t, values[:, None], 2)
    right = np.abs(found.values[:, 0] * stride**2 - 2).max() < 1e-6
    assert right == (not short)
    assert right == (found.doubt < 1e-6)


@pytest.mark.parametrize(("step", "left_out"), [(8.9, []), (9.1, [18, 19, 20, 21])])
def test_a_stencil_more_than_three_times_as_wide_as_most_lies_across_a_gap(step, left_out):
    t = np.cumsum(np.where(np.arange(40) == 20, step, 1.0))
    found = over(t, t[:, None], 1, 1)
    assert sorted({*range(2, 38)} - {*found.at.tolist()}) == left_out
    assert found.values == pytest.approx(1.0, rel=1e-9)


def test_samples_are_told_by_how_far_they_are_from_the_cubic_through_four_neighbours():
    """Of t^4 that is the product of the distances of the four: 4 at equal steps of 1."""
    t = np.arange(9.0)
    assert roughness(t, t[:, None] ** 4, np.arange(2, 7)) == pytest.approx(4.0, rel=1e-9)
    t = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 12))
    at = np.array([2, 5, 9])
    around = [np.prod([abs(t[k + j] - t[k]) for j in (-2, -1, 1, 2)]) for k in at]
    assert roughness(t, t[:, None] ** 4, at)[:, 0] == pytest.approx(around, rel=1e-8)
    assert np.abs(roughness(t, t[:, None] ** 3, at)).max() < 1e-9 * t[-1] ** 3


def test_no_polynomial_goes_through_two_samples_at_nearly_one_time():
    times = np.arange(12.0)
    times[1] = 1e-200
    values = (2 * times + 1)[:, None]
    found = roughness(times, values, np.arange(2, 10))[:, 0]
    assert np.isnan(found[0])
    np.testing.assert_allclose(found[2:], 0, atol=1e-9)

"""Test functions over many samples are (1 - u^2)^8 and its derivatives, times the weights of a sum."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import torch
from helpers import close, generator
from numpy.polynomial import Polynomial

from ahnn.training.weak_test_functions import bumps, integrated, quadrature

DOUBLE = {"dtype": torch.float64}
STEP = 0.2


@pytest.mark.parametrize(("order", "sign"), [(1, 1), (2, -1)])
def test_test_functions_are_bumps_and_their_derivatives(order, sign):
    times = 3.0 + STEP * torch.arange(241, **DOUBLE).unsqueeze(0)
    tests = bumps(times, torch.ones(1, 241, dtype=torch.bool), 60, order)
    assert tests.stride == 20
    assert tests.on_field.shape == (1, 7, 121)
    bump, u = Polynomial([1, 0, -1]) ** 8, torch.linspace(-1, 1, 121, **DOUBLE)
    derivative = sign * bump.deriv(order)(u.numpy()) / (60 * STEP) ** order
    for span in range(7):
        close(tests.on_field[0, span], STEP * torch.from_numpy(bump(u.numpy())), 1e-12)
        close(tests.on_data[0, span], STEP * torch.from_numpy(derivative), 1e-6)


@pytest.mark.parametrize(("order", "sign"), [(1, 1), (2, -1)])
def test_at_uneven_times_they_are_the_same_with_the_weights_of_these(order, sign):
    steps = 0.6 + 0.8 * torch.rand(2, 240, generator=generator(4), **DOUBLE)
    times = torch.nn.functional.pad(steps.cumsum(1), (1, 0))
    tests = bumps(times, torch.ones(2, 241, dtype=torch.bool), 60, order)
    bump, span = Polynomial([1, 0, -1]) ** 8, 20 * torch.arange(7).unsqueeze(-1) + torch.arange(121)
    half = (times[:, span[:, -1]] - times[:, span[:, 0]]).unsqueeze(-1) / 2
    u = ((times[:, span] - times[:, span[:, :1]]) / half - 1).numpy()
    close(tests.on_field, quadrature(times)[:, span] * torch.from_numpy(bump(u)), 1e-12)
    derivative = sign * torch.from_numpy(bump.deriv(order)(u)) / half**order
    close(tests.on_data, quadrature(times)[:, span] * derivative, 1e-3)


def test_spans_follow_each_other_and_know_what_is_missing():
    present = torch.ones(1, 241, dtype=torch.bool)
    present[0, 45] = False
    tests = bumps(STEP * torch.arange(241, **DOUBLE).unsqueeze(0), present, 60)
    assert tests.there.tolist() == [[False, False, False, True, True, True, True]]
    ramp = torch.arange(241, **DOUBLE).view(1, -1, 1)
    centres = integrated(tests.on_field, tests.stride, ramp) / tests.on_field.sum(-1, keepdim=True)
    close(centres.flatten(), 60.0 + 20 * torch.arange(7, **DOUBLE), 1e-12)


def halved(times, uneven=3.0):
    """The rule through each three samples, halved; two more steps at either end are like the last."""
    steps = np.diff(times)
    steps = np.concatenate(([steps[0]] * 2, steps, [steps[-1]] * 2))
    at, total = np.concatenate(([0.0], steps.cumsum())), np.zeros(len(steps) + 1)
    for k, (a, b) in enumerate(pairwise(steps)):
        x = at[k : k + 3] - at[k]
        if max(a / b, b / a) > uneven:
            total[k : k + 3] += [a / 4, (a + b) / 4, b / 4]
        else:
            moments = np.diff([[0.0, 0.0, 0.0], x[2] ** np.arange(1, 4) / np.arange(1, 4)], axis=0)[0]
            total[k : k + 3] += np.linalg.solve(np.vander(x, 3, increasing=True).T, moments) / 2
    return total[2:-2]


@pytest.mark.parametrize("ratio", [1.0, 2.0, 2.95, 3.05, 50.0])
def test_weights_are_those_of_parabolas_or_of_straight_lines_where_steps_differ_threefold(ratio):
    steps = np.array([1.0, 1.0, ratio, ratio, 1.0, ratio, 1.0, 1.3, 1.3 * ratio, 1.1, 0.9 * ratio])
    times = 7.0 + 0.3 * np.concatenate(([0.0], steps.cumsum()))
    given = torch.from_numpy(np.stack((times, -times[::-1])))
    expected = np.stack((halved(times), halved(-times[::-1])))
    close(quadrature(given), torch.from_numpy(expected), 1e-12)


@pytest.mark.parametrize(
    ("order", "samples", "asked", "half", "stride"),
    [
        (1, 101, 5, 10, 3),
        (1, 101, 10, 10, 3),
        (1, 101, 11, 11, 3),
        (1, 101, 12, 12, 4),
        (2, 101, 3, 6, 2),
        (2, 101, 7, 7, 2),
        (1, 16, 5, 7, 2),  # no more than there are
        (1, 5, 5, 2, 1),
        (2, 3, 1, 1, 1),
    ],
)
def test_spans_are_as_wide_as_sums_need_and_begin_three_within_half_a_width(
    order, samples, asked, half, stride
):
    times = 0.1 * torch.arange(samples, **DOUBLE).unsqueeze(0)
    tests = bumps(times, torch.ones(1, samples, dtype=torch.bool), asked, order)
    count = (samples - 1 - 2 * half) // stride + 1
    assert (tests.stride, tests.on_field.shape) == (stride, (1, count, 2 * half + 1))


@pytest.mark.parametrize(("samples", "degree"), [(60, 7), (9, 6), (5, 2)])
@pytest.mark.parametrize("order", [1, 2])
def test_sums_vanish_for_polynomials_and_their_derivatives(order, samples, degree):
    """At any times: what a large mean position would show in few samples. A higher power leaves something."""
    steps = 0.6 + 0.8 * torch.rand(2, samples - 1, generator=generator(2), **DOUBLE)
    times = torch.nn.functional.pad(steps.cumsum(1), (1, 0))
    tests = bumps(times, torch.ones(2, samples, dtype=torch.bool), 6, order)
    width = tests.on_field.shape[-1]
    spans = tests.stride * torch.arange(tests.on_field.shape[1]).unsqueeze(-1) + torch.arange(width)
    u = (times[:, spans] - times[:, spans].mean(-1, keepdim=True)) / (width / 2)
    for power in range(degree + 2):
        factor = power if order == 1 else power * (power - 1)
        slope = factor * u ** max(power - order, 0) / (width / 2) ** order
        terms = torch.cat((tests.on_data * u**power, tests.on_field * slope), dim=-1)
        left = terms.sum(-1).abs() / terms.abs().sum(-1)
        assert float(left.max()) < 1e-9 if power <= degree else float(left.max()) > 1e-6


@pytest.mark.parametrize("with_rates", [False, True])
@pytest.mark.parametrize("width", [10, 11, 12])
def test_covariances_are_those_of_all_sums_and_zero_for_spans_that_do_not_overlap(width, with_rates):
    """A sum is that of on_data n + on_field J n over its span, with unit noise n of each sample."""
    times = (0.1 * torch.arange(61, **DOUBLE)).expand(2, -1)
    present = torch.ones(2, 61, dtype=torch.bool)
    present[1, 40] = False
    tests = bumps(times, present, width)
    rates = torch.randn(2, 61, 3, 3, generator=generator(1), **DOUBLE) if with_rates else None
    count, reach = tests.on_field.shape[1:]
    effects = torch.zeros(2, count, 3, 61, 3, **DOUBLE)
    for j in range(count):
        span = slice(tests.stride * j, tests.stride * j + reach)
        own = tests.on_data[:, j, :, None, None] * torch.eye(3, **DOUBLE)
        if rates is not None:
            own = own + tests.on_field[:, j, :, None, None] * rates[:, span]
        effects[:, j, :, span] = own.transpose(1, 2) * tests.there[:, j, None, None, None]
    dense = torch.einsum("bjcka,blika->bjlci", effects, effects)
    bands = tests.covariances(3, rates)
    for distance in range(count):
        exact = dense.diagonal(-distance, 1, 2).movedim(-1, 1)
        found = bands[distance].expand(2, -1, -1, -1) if distance < len(bands) else torch.zeros_like(exact)
        assert float((found - exact).abs().max()) <= 1e-13 * float(dense.abs().max())
    assert not bool(tests.there[1].all())
    assert bool(tests.there[1].any())

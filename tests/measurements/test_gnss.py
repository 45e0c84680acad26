"""Pseudoranges to satellites, and the interpolation of their positions."""

from __future__ import annotations

import math

import pytest
import torch

from ahnn.measurements import GnssRange
from ahnn.measurements.interpolation import lagrange

F64 = torch.float64


X = torch.tensor([[7000.0, 0.0, 0.0, 0.0, 7.5, 0.0]], dtype=F64)
SATELLITES = torch.tensor([[20000.0, 0.0, 0.0], [0.0, 20000.0, 0.0]], dtype=F64)


def test_ranges_to_constant_positions():
    expected = torch.tensor([[13000.0, math.hypot(7000.0, 20000.0)]], dtype=F64)
    assert torch.allclose(GnssRange(SATELLITES)(X, 0.0), expected, rtol=1e-15)


def polynomial(t, degree):
    """Sum of (t/100)^k/(k+1), (..., 1)."""
    t = torch.as_tensor(t, dtype=F64)
    return sum((t / 100.0) ** k / (k + 1.0) for k in range(degree + 1)).unsqueeze(-1)


@pytest.mark.parametrize("order", [1, 2, 5, 8, 11])
def test_interpolation_is_exact_on_polynomials_of_its_order_and_no_further(order):
    generator = torch.Generator().manual_seed(order)
    times = (10.0 * torch.rand(16, generator=generator, dtype=F64) + 5.0).cumsum(0)
    inner = torch.linspace(float(times[0]), float(times[-1]), 101, dtype=F64).tolist()
    for degree, exact in ((order, True), (order + 1, False)):
        table = polynomial(times, degree)
        off = max(float((lagrange(times, table, t, order) - polynomial(t, degree)).abs()) for t in inner)
        assert (off < 1e-10) == exact


def circle(t, radius=26560.0, rate=2.0 * math.pi / 43077.5):
    t = torch.as_tensor(t, dtype=F64)
    return radius * torch.stack((torch.cos(rate * t), torch.sin(rate * t), 0.0 * t), dim=-1)


@pytest.mark.parametrize("order", [1, 2, 5, 8])
def test_the_error_on_a_circular_orbit_is_within_its_bound_and_near_it(order):
    radius, rate, h = 26560.0, 2.0 * math.pi / 43077.5, 900.0
    times = h * torch.arange(24, dtype=F64)
    table = circle(times)
    for begin in (0.0, 11 * h):
        share = []
        for t in (begin + torch.linspace(0.05, 0.95, 19, dtype=F64) * h).tolist():
            # The window that the docstring promises: the nearest order + 1 rows, as far as the table goes.
            nodes = times[(times - t).abs().argsort()[: order + 1]]
            product = float((t - nodes).abs().prod())
            bound = product * radius * rate ** (order + 1) / math.factorial(order + 1)
            share.append(float((lagrange(times, table, t, order) - circle(t)).norm()) / bound)
        assert max(share) < 1.001
        assert min(share) > 0.9
    middle = (lagrange(times, table, 11.5 * h, 8) - circle(11.5 * h)).norm()
    end = (lagrange(times, table, 0.4 * h, 8) - circle(0.4 * h)).norm()
    assert float(middle) < 2.0e-7 < 3.5e-6 < float(end) < 5.0e-6  # km: 0.2 mm and 5 mm


def test_a_table_is_exact_at_its_times_and_smooth_between_them():
    times = 300.0 * torch.arange(12, dtype=F64)
    table = GnssRange(circle(times)[:, None], times)
    for k in (0, 5, 11):
        expected = (X[:, :3] - circle(times)[k]).square().sum(-1).sqrt()
        assert torch.equal(table(X, float(times[k]))[:, 0], expected)
        assert torch.equal(table(X, float(times[k]) * (1.0 + 1e-15))[:, 0], expected)
    between = (X[:, :3] - circle(1234.5)).norm(dim=-1)
    assert torch.allclose(table(X, 1234.5)[:, 0], between, rtol=1e-11)


@pytest.mark.parametrize("t", [-0.1, 3300.1, math.nan, math.inf])
def test_no_time_outside_of_a_table(t):
    times = 300.0 * torch.arange(12, dtype=F64)
    with pytest.raises(
        ValueError, match=rf"GnssRange: expected a time within the table, 0 to 3300; received {t:g}"
    ):
        GnssRange(circle(times)[:, None], times)(X, t)


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        (
            (torch.zeros(2, 2, 3), None),
            {},
            r"expected positions \(N, 3\) .* received \(2, 2, 3\) and no times",
        ),
        ((SATELLITES, [0.0, 1.0]), {}, r"received \(2, 3\) and times \(2,\)"),
        ((torch.zeros(3, 2, 3), [0.0, 1.0]), {}, r"received \(3, 2, 3\) and times \(2,\)"),
        ((torch.zeros(2, 2, 3), [[0.0], [1.0]]), {}, r"and times \(2, 1\)"),
        (([[math.nan, 0.0, 0.0]], None), {}, r"expected finite positions; received nan at \[0, 0\]"),
        (([[1j, 0.0, 0.0]], None), {}, "GnssRange: positions: expected real numbers"),
        ((torch.zeros(2, 1, 3), [0.0, math.inf]), {}, r"expected finite times; received inf at \[1\]"),
        ((torch.zeros(2, 1, 3), [1.0, 1.0]), {"order": 1}, "expected increasing times; received"),
        ((torch.zeros(8, 1, 3), list(range(8))), {}, "at least 9 rows for order=8; received 8; .* order=7"),
        ((torch.zeros(8, 1, 3), list(range(8))), {"order": 0}, "expected a whole order >= 1; received 0"),
    ],
)
def test_mistakes_are_named(arguments, options, message):
    with pytest.raises(ValueError, match=message):
        GnssRange(*arguments, **options)


def test_gnss_clock_is_a_component_of_the_state():
    x = torch.tensor([[7000.0, 0.0, 0.0, 0.0, 7.5, 0.0, 0.3]], dtype=F64)
    satellites = torch.tensor([[20000.0, 0.0, 0.0]], dtype=F64)
    assert float(GnssRange(satellites, clock=6)(x, 0.0)) == pytest.approx(13000.3, rel=1e-15)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 7, 8])
def test_the_rows_of_a_polynomial_are_the_nearest_ones_up_to_the_ends_of_the_table(order):
    """Its value at a time is a sum over rows; unit vectors tell which of them, and how heavy they are."""
    times = 900.0 * torch.arange(14, dtype=F64)
    for t in torch.linspace(10.0, 13 * 900.0 - 10.0, 73, dtype=F64).tolist():
        nearest = (times - t).abs().argsort()[: order + 1].tolist()
        expected = torch.zeros(14, dtype=F64)
        for k in nearest:
            others = times[[j for j in nearest if j != k]]
            expected[k] = ((t - others) / (times[k] - others)).prod()
        assert torch.allclose(
            lagrange(times, torch.eye(14, dtype=F64), t, order), expected, rtol=0, atol=1e-11
        )

"""Local polynomials: exact on cubics, at any times, and as wide as the noise asks for."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator

from ahnn.measurements import Instrument, Position, Segment, State, smoothing
from ahnn.measurements.smoothing import around, guess, local_polynomials, smoothed

DOUBLE = {"dtype": torch.float64}
COEFFICIENTS = torch.tensor([1.0, -2.0, 0.5, 0.25], **DOUBLE)


def cubic(t):
    return (t.unsqueeze(-1) ** torch.arange(4)) @ COEFFICIENTS


def test_cubics_are_exact_at_irregular_times_with_gaps():
    t = 3 * torch.rand(5, 9, generator=generator(0), **DOUBLE).sort(dim=1).values
    values = cubic(t).unsqueeze(-1)
    values[:, 2] = torch.nan
    at = t[:, 4:5]
    local = local_polynomials(values, t - at, 4)
    close(local.value[:, 0], cubic(at[:, 0]), 1e-9)
    close(local.rate[:, 0], -2 + at[:, 0] + 0.75 * at[:, 0] ** 2, 1e-7)
    close(local.curvature[:, 0], 1 + 1.5 * at[:, 0], 1e-6)
    assert float(local.error.abs().max()) < 1e-8


def test_the_error_of_a_sample_is_that_of_the_polynomial_without_it():
    t = torch.arange(9, **DOUBLE).unsqueeze(0)
    values = torch.randn(1, 9, 1, generator=generator(1), **DOUBLE)
    without = values.clone()
    without[:, 4] = torch.nan
    left_out = local_polynomials(without, t - 4, 4).value
    close(local_polynomials(values, t - 4, 4).error, values[:, 4] - left_out, 1e-9)


def test_standard_deviations_of_derivatives_are_their_scatter_over_draws_of_the_noise():
    t = torch.tensor([0.0, 0.3, 0.9, 1.4, 2.2, 2.5, 3.1], **DOUBLE).expand(20_000, -1)
    sds = torch.tensor([0.1, 4.0], **DOUBLE)
    noise = sds * torch.randn(*t.shape, 2, generator=generator(8), **DOUBLE)
    found = local_polynomials(cubic(t).unsqueeze(-1) + noise, t - 1.4, 3)
    close(found.rate_sd.square().mean(0).sqrt(), found.rate.std(0), 0.03)
    close(found.curvature_sd.square().mean(0).sqrt(), found.curvature.std(0), 0.03)


def waves(sd, count=20):
    t = 0.01 * torch.arange(1001, **DOUBLE).expand(count, -1)
    phase = torch.rand(count, 1, generator=generator(2), **DOUBLE) * 6
    noise = sd * torch.randn(count, 1001, 1, generator=generator(3), **DOUBLE)
    return (2 * t + phase).sin().unsqueeze(-1) + noise, t


def test_more_noise_means_wider_polynomials_and_rates_stay_right():
    instrument = Instrument(Position(1), torch.ones(1), 0.01, 1, 1.0)
    widths = []
    for sd in (1e-5, 1e-3, 1e-1):
        values, t = waves(sd)
        local = smoothed(instrument, values, t, 2000)
        widths.append(local.width)
        assert abs(float(local.rate.square().mean().sqrt()) / 2**0.5 - 1) < max(0.03, 5 * sd)
    assert widths == sorted(widths)
    assert widths[0] < widths[2]


def test_starts_are_guessed_from_the_first_samples():
    t = 0.1 * torch.arange(10, **DOUBLE).expand(2, -1)
    values = torch.stack((cubic(t[0]), cubic(t[1]) + 1)).unsqueeze(-1)
    seen = Segment(values, t, Instrument(Position(1), torch.ones(1), 0.1, 1, 3.0))
    close(guess(seen), torch.tensor([[1.0, -6.0], [2.0, -6.0]]), 1e-9)
    states = torch.cat((values, values + 5), dim=-1)
    late = seen._replace(times=t + 50.0)  # a segment begins at any time
    close(guess(late), guess(seen), 1e-9)
    whole = Segment(states, t, Instrument(State(1), torch.ones(2), 0.1, 1, 3.0))
    close(guess(whole), states[:, 0], 1e-9)


def test_a_sample_without_neighbours_says_nothing_of_rates():
    """The only sighting of a pass."""
    instrument = Instrument(Position(1), torch.ones(1), 0.01, 1, 1.0)
    values, t = waves(1e-3)
    lonely = values.clone()
    lonely[:10, :] = torch.nan
    lonely[:10, 500] = values[:10, 500]
    local = smoothed(instrument, lonely, t, 100_000)
    assert len(local.value) == 10 * 1001
    assert bool(local.curvature.isfinite().all())
    close(local.rate.square().mean().sqrt(), torch.tensor(2**0.5), 0.05)


def test_neighbours_reach_from_the_first_sample_to_the_last():
    """Five samples hold a cubic and one more, which tells nothing of another width."""
    t = torch.arange(5.0, **DOUBLE).expand(2, -1) * 0.3
    values = cubic(t).unsqueeze(-1)
    values[1, 0] = torch.nan
    instrument = Instrument(Position(1), torch.ones(1, **DOUBLE), 0.3, 1, 1.0)
    chosen = torch.tensor([[0, 2], [1, 2], [0, 1], [0, 3]])
    local = around(instrument, values, t, chosen, 2)
    close(local.value, cubic(t[:1, 2]).unsqueeze(-1), 1e-9)  # the others have four samples
    wide = around(instrument, values, t, chosen, 3)
    close(wide.rate.flatten(), -2 + t[0, [2, 1, 3]] + 0.75 * t[0, [2, 1, 3]] ** 2, 1e-7)


def test_a_seventh_sample_has_no_part_in_a_guess():
    t = 0.3 * torch.arange(9.0, **DOUBLE).unsqueeze(0)
    values = cubic(t).unsqueeze(-1)
    instrument = Instrument(Position(1), torch.ones(1, **DOUBLE), 0.3, 1, 1.0)
    values[:, 6:] = 1e6
    close(guess(Segment(values, t, instrument)), torch.tensor([[1.0, -2.0]]), 1e-9)
    values[:, 5] = 1e6
    assert float(guess(Segment(values, t, instrument)).abs().max()) > 100


def test_widths_do_not_depend_on_the_units_of_a_component():
    """A fast motion asks for narrow polynomials and a slow one in much noise for wide ones."""
    t = 0.01 * torch.arange(1001, **DOUBLE).expand(6, -1)
    slow = (0.3 * t).sin() + 0.05 * torch.randn(6, 1001, generator=generator(4), **DOUBLE)
    values = torch.stack(((40 * t).sin(), slow), dim=-1)
    instrument = Instrument(Position(2), torch.ones(2), 0.01, 2, 1.0)
    seen = [
        smoothed(instrument, values * torch.tensor(units), t, 500) for units in ([1, 1], [1e6, 1], [1, 1e6])
    ]
    assert len({local.width for local in seen}) == 1
    alone = [
        smoothed(Instrument(Position(1), torch.ones(1), 0.01, 1, 1.0), values[..., k : k + 1], t, 500).width
        for k in (0, 1)
    ]
    assert alone[0] < seen[0].width <= alone[1]
    close(seen[1].rate[:, 0], 1e6 * seen[0].rate[:, 0], 1e-9)


@pytest.mark.parametrize("samples", [4, 16, 17, 24, 25, 36, 37, 180, 181])
def test_no_polynomial_is_wider_than_a_trajectory_but_for_the_narrowest(samples, monkeypatch):
    """Those of up to six samples on either side are tried in any case."""
    seen, t = [], 0.1 * torch.arange(samples, **DOUBLE).unsqueeze(0)
    local = smoothing.Local(*torch.randn(6, 3, 1, generator=generator(1), **DOUBLE))
    monkeypatch.setattr(smoothing, "around", lambda *given: seen.append(given[-1]) or local)
    smoothed(Instrument(Position(1), torch.ones(1), 0.1, 1, 1.0), cubic(t).unsqueeze(-1), t, 7)
    assert seen == [width for width in smoothing.WIDTHS if width <= 6 or 2 * width + 1 <= samples]


def test_residuals_are_predicted_minus_measured_in_deviations_and_zero_where_nothing_was_measured():
    values = torch.tensor([[[1.0, 2.0], [torch.nan, -1.0]]], **DOUBLE)
    deviations = torch.tensor([0.5, 4.0], **DOUBLE)
    seen = Segment(values, torch.zeros(1, 2), Instrument(Position(2), deviations, 0.1, 2, 1.0))
    states = torch.tensor([[[2.0, 0.0, 9.0, 9.0], [3.0, 3.0, 9.0, 9.0]]], **DOUBLE)
    assert seen.residuals(states).tolist() == [[[2.0, -0.5], [0.0, 1.0]]]
    assert seen.measured.tolist() == [3]


@pytest.mark.parametrize(("samples", "degree"), [(2, 0), (3, 1), (4, 2), (5, 3)])
def test_trajectories_too_short_for_a_cubic_have_polynomials_of_two_degrees_less_than_samples(
    samples, degree
):
    """Which are exact where the motion is one, and leave an error of the sample in the middle to judge by."""
    t = torch.rand(30, samples, generator=generator(6), **DOUBLE).sort(dim=1).values
    motion = COEFFICIENTS * (torch.arange(4) <= degree)
    exact = (t.unsqueeze(-1) ** torch.arange(4)) @ motion
    instrument = Instrument(Position(1), torch.ones(1), 0.1, 1, 1.0)
    local = smoothed(instrument, exact.unsqueeze(-1), t, 1000)
    row, column = local.chosen.unbind(-1)
    close(local.value[:, 0], exact[row, column], 1e-9)
    slope = (t.unsqueeze(-1) ** torch.arange(3)) @ (motion[1:] * torch.arange(1, 4))
    assert float((local.rate[:, 0] - slope[row, column]).abs().max()) < 1e-6
    noisy = exact + torch.randn(30, samples, generator=generator(7), **DOUBLE)
    assert float(smoothed(instrument, noisy.unsqueeze(-1), t, 1000).error.abs().median()) > 0.3

"""Whitening held against the dense covariance of coloured noise."""

from __future__ import annotations

import math

import pytest
import torch
from helpers import close, generator

from ahnn.errors import UserError
from ahnn.measurements import Instrument, NoiseEstimate, Position, Segment, UnknownNoise
from ahnn.measurements.coloured_noise import Colour, Whitening

DOUBLE = {"dtype": torch.float64}
COLOUR = Colour(torch.tensor([0.6, 1.0, 0.0], **DOUBLE), torch.tensor([0.7, 1.5, 1.0], **DOUBLE))
TIMES = torch.rand(2, 9, generator=generator(0), **DOUBLE).cumsum(1)
THERE = torch.rand(2, 9, 3, generator=generator(1)) > 0.3


def covariance(row, number):
    """The correlation matrix of the noise of one number, where it was measured."""
    fraction, memory, t = COLOUR.fractions[number], COLOUR.memories[number], TIMES[row]
    dense = fraction * (-(t[:, None] - t).abs() / memory).exp() + (1 - fraction) * torch.eye(9, **DOUBLE)
    own = THERE[row, :, number]
    return dense[own][:, own]


@pytest.mark.parametrize("row", [0, 1])
@pytest.mark.parametrize("number", [0, 1, 2])
def test_whitened_noise_has_a_unit_covariance(row, number):
    own = THERE[row, :, number]
    units = torch.eye(9, **DOUBLE)
    rows = units[None, :, None, :].expand(2, 9, 3, 9)
    white = Whitening.of(COLOUR, TIMES, THERE)(rows)[row, :, number]
    white = white[own][:, own]
    close(white @ covariance(row, number) @ white.T, torch.eye(int(own.sum()), **DOUBLE), 1e-12)


def test_what_was_not_measured_is_zero_and_the_determinant_is_that_of_the_covariance():
    whitening = Whitening.of(COLOUR, TIMES, THERE)
    assert (whitening(torch.ones(2, 9, 3, **DOUBLE))[~THERE] == 0).all()
    dense = torch.stack([sum(covariance(row, number).logdet() for number in range(3)) for row in range(2)])
    close(whitening.log_determinant, dense, 1e-12)


def test_the_transpose_is_the_transpose():
    whitening = Whitening.of(COLOUR, TIMES, THERE)
    x, y = torch.randn(2, 2, 9, 3, 4, generator=generator(2), **DOUBLE)
    close((whitening(x) * y).sum(), (x * whitening.transposed(y)).sum(), 1e-12)


def test_a_bias_is_taken_off_readings_and_an_angle_stays_one():
    instrument = Instrument(Position(1, "rad"), torch.tensor([0.1], **DOUBLE), 1.0, 1, 1.0)
    biased = instrument._replace(bias=torch.tensor([0.2], **DOUBLE))
    values = torch.tensor([[[3.1], [-3.0]]], **DOUBLE)
    states = torch.tensor([[[3.1, 0.0], [3.0, 0.0]]], **DOUBLE)
    segment = Segment(values, torch.tensor([[0.0, 1.0]], **DOUBLE), biased)
    expected = torch.tensor([[[2.0], [(3.2 + 3.0 - 2 * math.pi) / 0.1]]], **DOUBLE)
    close(segment.residuals(states), expected, 1e-12)
    close(segment.white_residuals(states), expected, 1e-12)


FOUND = NoiseEstimate(
    deviations=[0.01, 0.2],
    stated=[0.03, 0.2],
    fractions=[0.64, 0.0],
    memories=[0.5, 1.0],
    bias=[0.005, 0.0],
    bias_sd=[0.0003, 0.099],
    prior_sd=[0.01, 0.1],
)


def test_an_estimate_is_said_in_words_with_the_options_of_filters():
    size, colour, told, left = FOUND.sentences(("q1", "q2"), ("rad", "m"))
    assert "q1 0.01 rad (0.33 times the initial value), q2 0.2 m (1 times" in size
    assert "64 % of the noise variance of q1 over times of 0.5" in colour
    assert (
        "measurement.sd=[0.006,0.2] measurement.bias_sd=[0.008,0] measurement.bias_memory=[0.5,1]" in colour
    )
    assert told.endswith("q1 +0.005 ± 0.0003 rad")
    assert "q2 cannot be separated" in left


def test_only_what_was_unknown_is_taken_from_an_estimate():
    instrument = Instrument(Position(2), torch.tensor([1.0, 2.0], **DOUBLE), 1.0, 2, 1.0)
    sizes = FOUND.applied(instrument, UnknownNoise(sizes=True))
    assert sizes.deviations.tolist() == FOUND.deviations
    assert (sizes.colour, sizes.bias) == (None, None)
    rest = FOUND.applied(instrument, UnknownNoise(False, True, torch.ones(2)))
    assert rest.deviations.tolist() == [1.0, 2.0]
    assert rest.colour is not None
    assert rest.bias is not None
    assert rest.bias.tolist() == FOUND.bias
    with pytest.raises(UserError, match="noise: expected estimates for 1 measured components"):
        FOUND.applied(instrument._replace(deviations=torch.ones(1)), UnknownNoise(sizes=True))

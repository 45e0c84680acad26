"""Forecasts of held-out measurements: their variances, and the covariance that they ask for."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator
from oscillators import Swing, segment
from torch.nn.utils import parameters_to_vector

from ahnn.measurements import Position
from ahnn.shooting.robust import ROBUST
from ahnn.training.forecasts import Forecast, forecasts, needed_scale
from ahnn.training.posterior import WideProblem

DOUBLE = {"dtype": torch.float64}
SPREAD = torch.tensor([[0.02, 0.0], [0.01, 0.03]], **DOUBLE)
"""Factor of the covariance that parameters are drawn from."""


def batch_of(seed, sd):
    return segment(rows=10, intervals=40, measurement=Position(1), seed=seed, sd=sd, longest=0.05)[1]


def forecast_of(batch, off, factor, robust="none", offset=(0.0, 0.0)):
    model = Swing(*(torch.tensor([2.0, 0.5], **DOUBLE) + off).tolist())
    problem = WideProblem(model, batch, ROBUST[robust])
    return forecasts(
        problem, parameters_to_vector(model.parameters()).detach(), factor, torch.tensor(offset, **DOUBLE)
    )


def test_the_spread_is_what_parameters_do_to_forecasts():
    """Off by each column of a factor in turn, squares of what is missed add up to the variance."""
    factor, batch = 0.02 * SPREAD, batch_of(0, 1e-7)
    found = [forecast_of(batch, column, factor) for column in factor.T]
    total = torch.stack([one.missed.square() for one in found]).sum(0)
    again = forecast_of(batch, factor[:, 0], factor[:, 1:], offset=factor[:, 0].tolist())
    close(again.known - found[0].known + again.spread, found[0].spread, 1e-3)
    there = total.isfinite()
    close(total[there], found[0].spread[there], 0.03)
    assert float(found[0].known.mean() / found[0].spread.mean()) < 1e-3


def test_what_is_known_is_noise_and_the_error_of_the_start():
    found = [forecast_of(batch_of(seed, 0.02), torch.zeros(2, **DOUBLE), SPREAD) for seed in range(40)]
    missed, known = (torch.cat([getattr(one, name) for one in found]) for name in ("missed", "known"))
    missed, known = (of[missed.isfinite()] for of in (missed, known))
    early = known < known.median()
    for some in (early, ~early):
        assert float((missed.square() / known)[some].mean()) == pytest.approx(1, rel=0.12)
    assert float(known[~early].mean() / known[early].mean()) > 1.1


def test_noise_alone_asks_for_nothing():
    """Exact parameters, and noise that is twice what was said."""
    batch = batch_of(0, 0.05)
    narrow = batch._replace(instrument=batch.instrument._replace(deviations=batch.instrument.deviations / 2))
    for data in (batch, narrow):
        assert needed_scale(forecast_of(data, torch.zeros(2, **DOUBLE), 1e-3 * SPREAD)) == 1


def test_parameters_that_are_off_ask_for_more():
    off = 5 * SPREAD @ torch.ones(2, **DOUBLE)
    assert 5 < needed_scale(forecast_of(batch_of(0, 0.001), off, SPREAD)) < 200


def test_outliers_ask_for_nothing_where_the_loss_is_robust():
    batch, still = batch_of(0, 0.01), torch.zeros(2, **DOUBLE)
    hit = torch.rand(batch.values.shape, generator=generator(7), **DOUBLE) < 0.1
    spoilt = batch._replace(values=torch.where(hit, batch.values + 0.5, batch.values))
    robust = forecast_of(spoilt, still, 1e-2 * SPREAD, "student")
    assert needed_scale(robust) == 1
    clean = forecast_of(batch, still, 1e-2 * SPREAD, "student")
    assert int(robust.missed.isfinite().sum()) < 0.97 * int(clean.missed.isfinite().sum())


@pytest.mark.parametrize("factor", [1.0, 9.0, 100.0])
def test_the_scale_is_that_of_what_was_drawn(factor):
    size = 50, 1000
    spread = torch.rand(size, generator=generator(0), **DOUBLE)
    known = torch.rand(size, generator=generator(1), **DOUBLE)
    drawn = (known + factor * spread).sqrt() * torch.randn(size, generator=generator(2), **DOUBLE)
    assert needed_scale(Forecast(drawn, known, spread)) == pytest.approx(factor, rel=0.1)


def test_nothing_asks_for_nothing():
    nothing = torch.full((8, 3), torch.nan, **DOUBLE)
    assert needed_scale(Forecast(nothing, nothing, nothing)) == 1.0

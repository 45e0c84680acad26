"""Forecasts whose errors propagate linearly are told from those whose errors do not."""

from __future__ import annotations

import pytest
import torch
from cases import SPRING, Learned, trajectories
from test_forecast import DOUBLE, LONG, known, measured
from torch import nn

from ahnn.evaluation.forecast import forecast
from ahnn.numbers import in_percent


class Hardening(nn.Module):
    """A spring that is stiffer far from rest."""

    def __init__(self, stiffness):
        super().__init__()
        self.stiffness = nn.Parameter(torch.tensor([stiffness], **DOUBLE))

    def forward(self, x):
        q, p = x.chunk(2, dim=-1)
        return torch.cat((p / SPRING.mass, -self.stiffness * (q + 0.5 * q**3)), dim=-1)


class Stiffening(Learned):
    """Its flow by RK4."""

    def __init__(self, stiffness):
        super().__init__(stiffness)
        self.field = Hardening(stiffness)


def test_sampled_paths_judge_a_linear_spring_as_first_order_bands_do(monkeypatch):
    """Noise of the fitted measurements and parameters are uncertain, also where no state counts as linear."""
    truth = trajectories(LONG, 100, 3)
    given = Learned(LONG.stiffness), measured(truth), known(0.3)
    plain = forecast(*given, truth=truth)
    monkeypatch.setattr("ahnn.evaluation.forecast.LINEAR", -1.0)
    found = forecast(*given, truth=truth, samples=1000)
    assert plain is not None
    assert found is not None
    assert found.sampled is not None
    assert plain.sampled is None
    assert (found.nonlinear, found.states) == (1.0, plain.states)
    assert found.sampled.states == pytest.approx(plain.states, abs=0.01)
    for one, other in zip(found.sampled.parts, plain.parts, strict=True):
        assert one == pytest.approx(other, abs=0.03)


def test_the_linear_range_of_a_spring_is_all_of_it_and_of_a_stiffening_one_where_bands_are_narrow():
    truth = trajectories(LONG, 40, 3)
    linear = forecast(Learned(LONG.stiffness), measured(truth), known(0.3), truth=truth)
    assert linear is not None
    assert linear.nonlinear == 0
    assert "propagate linearly" not in linear.sentence()
    assert linear.linear is not None
    assert linear.linear.states == linear.states
    assert linear.linear.parts == linear.parts
    stiffening = Stiffening(LONG.stiffness)
    narrow, wide = (forecast(stiffening, measured(truth), known(sd), truth=truth) for sd in (1e-6, 8.0))
    assert narrow is not None
    assert wide is not None
    assert narrow.nonlinear < 0.05 < 0.2 < wide.nonlinear < 1
    assert (
        f"the errors of {in_percent(wide.nonlinear)} of the states do not propagate linearly"
        in wide.sentence()
    )

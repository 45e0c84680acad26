"""Which parameters a stream's filter is given: directions along trajectories that the dynamics meet."""

from __future__ import annotations

import pytest
import torch
from helpers import close
from oscillators import DOUBLE, Swing, segment

from ahnn.shooting.path_sensitivities import path, steps_between
from ahnn.training import least_observable
from ahnn.training.laplace import conclude
from ahnn.training.least_observable import ENOUGH, LASTING, MOST, least_observable_directions
from ahnn.uncertainty.directions import filtered_directions

SPREAD = 0.02 * torch.eye(2, **DOUBLE)


@pytest.fixture
def watched(monkeypatch):
    """What is followed, and how many directions are asked for."""
    seen = []

    def looked(dynamics, spread, watched, most, enough, learned):
        seen.append((watched, most))
        return filtered_directions(dynamics, spread, watched, most, enough, learned)

    monkeypatch.setattr(least_observable, "filtered_directions", looked)
    return seen


def test_trajectories_are_followed_as_they_were_measured_from_starts_that_meet_them(watched):
    starts, measured = segment()
    found = least_observable_directions(Swing(), SPREAD, measured, "none", Swing())
    ((along, most),) = watched
    close(along.start, starts, 0.02)
    steps = steps_between(measured.times, measured.instrument.longest)
    sizes = path(Swing().increment, starts, steps.lengths).square().mean((0, 1)).sqrt()
    close(along.start_sd, sizes, 0.02)
    count = measured.times.shape[1]
    assert along.segment.times.shape[1] == LASTING * count
    assert torch.equal(along.segment.times[:, :count], measured.times)
    assert bool((along.segment.times.diff(dim=1) > 0).all())
    for values in along.segment.values.split(count, dim=1):
        assert torch.equal(values.isnan(), measured.values.isnan())
    assert most == MOST
    assert torch.equal(found, filtered_directions(Swing(), SPREAD, along, MOST, ENOUGH).directions)


def test_trajectories_that_cannot_be_continued_are_followed_as_they_are(watched, monkeypatch):
    """As those that fall into a singularity after their end."""
    monkeypatch.setattr(least_observable, "path", lambda *_: torch.full((1,), torch.nan))
    starts, measured = segment()
    assert least_observable_directions(Swing(), SPREAD, measured, "none", Swing()) is not None
    ((along, _),) = watched
    close(along.start, starts, 0.02)
    assert torch.equal(along.segment.times, measured.times)


def test_a_dozen_trajectories_are_enough(watched, monkeypatch):
    monkeypatch.setattr(least_observable, "INTERVALS", 7)
    starts, measured = segment(rows=50)
    least_observable_directions(Swing(), SPREAD, measured, "none", Swing())
    ((along, _),) = watched
    close(along.start, starts[::4], 0.1)
    assert along.segment.times.shape == (13, 8)


def test_trajectories_that_are_not_met_are_left_out(watched):
    starts, measured = segment()
    values = measured.values.clone()
    values[2] = 5.0 * torch.sin(40.0 * measured.times[2, :, None])
    strange = measured._replace(values=values)
    least_observable_directions(Swing(), SPREAD, strange, "none", Swing())
    ((along, _),) = watched
    close(along.start, starts[[0, 1, 3, 4, 5]], 0.02)
    assert least_observable_directions(Swing(), SPREAD, strange.rows(slice(2, 3)), "none", Swing()) is None


def test_outliers_are_weighed_down_as_in_the_training(watched):
    starts, measured = segment()
    values = measured.values.clone()
    values[:, 10] += 0.5  # fifty standard deviations
    for robust in ("none", "student"):
        least_observable_directions(Swing(), SPREAD, measured._replace(values=values), robust, Swing())
    off = [float((along.start - starts).abs().max()) for along, _ in watched]
    assert off[1] < 0.2 * off[0]


def test_a_training_keeps_the_directions_of_its_own_covariance():
    measured = segment(rows=8)[1]
    found = conclude(Swing(), measured, measured, 0)
    assert torch.equal(
        found.directions, least_observable_directions(Swing(), found.spread, measured, "none", Swing())
    )

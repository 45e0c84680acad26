"""Where a training on measurements was: along the paths that fit them, up to their ends."""

from __future__ import annotations

import torch
from helpers import close
from oscillators import Swing, segment

from ahnn.measurements import Position
from ahnn.shooting.robust import ROBUST
from ahnn.training import fitted_paths as module
from ahnn.training.fitted_paths import fitted_states
from ahnn.training.maximum_posterior import whole_problem
from ahnn.uncertainty import find_domain


def batch_of(longest=0.02, rows=6):
    return segment(rows=rows, intervals=20, measurement=Position(1), missing=0.0, longest=longest)[1]


def test_states_are_those_of_the_fitted_paths():
    batch = batch_of()
    states = whole_problem(Swing(), batch, ROBUST["none"]).fitted.states
    close(fitted_states(Swing(), batch, "none"), states.flatten(0, 1), 1e-12)


def test_long_steps_are_looked_into():
    batch = batch_of(longest=0.5)
    assert len(fitted_states(Swing(), batch, "none")) == 6 * (4 * 20 + 1)


def test_nothing_beyond_the_last_measurement_was_visited():
    batch = batch_of(longest=0.5)
    values = batch.values.clone()
    values[2, 11:] = torch.nan
    found = fitted_states(Swing(), batch._replace(values=values), "none")
    assert len(found) == 5 * 81 + 41


def test_of_many_some_are_looked_at_evenly(monkeypatch):
    batch = batch_of()
    half = fitted_states(Swing(), batch.rows(slice(None, None, 2)), "none")
    monkeypatch.setattr(module, "PATHS", 3)
    close(fitted_states(Swing(), batch, "none"), half, 0.0)
    monkeypatch.setattr(module, "STATES", 50)
    assert len(fitted_states(Swing(), batch, "none")) <= 50


def test_measurements_that_nothing_fits_were_nowhere():
    batch = batch_of()
    lost = batch._replace(values=1e6 * torch.randn(batch.values.shape, dtype=torch.float64))
    assert fitted_states(Swing(), lost, "none").shape == (0, 2)


def test_paths_between_far_samples_are_known_ground():
    """Of 30 orbits one sample in four is measured: what lies between is as near as what was measured."""
    batch = segment(rows=30, intervals=40, measurement=Position(1), missing=0.75, longest=0.02)[1]
    domain = find_domain(Swing(), fitted_states(Swing(), batch, "none"))
    paths = whole_problem(Swing(), batch, ROBUST["none"]).fitted.states
    assert float((domain.novelty(Swing(), paths) > 1).double().mean()) <= 0.011

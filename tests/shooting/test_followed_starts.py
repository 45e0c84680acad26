"""Starts that follow a change of the dynamics: on a chaotic path the fit from the old start fails."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from helpers import close, generator
from oscillators import DOUBLE

from ahnn.integrators import INTEGRATORS
from ahnn.jacobians import step_jacobians
from ahnn.measurements import Instrument, Segment, State
from ahnn.measurements.coloured_noise import Colour
from ahnn.shooting.initial_states import (
    FOLLOWING,
    SURE,
    WORSE,
    Trial,
    fit_starts,
    follow_starts,
    linearised,
    refine,
)
from ahnn.shooting.path_sensitivities import path, steps_between
from ahnn.shooting.robust import ROBUST

STEP, INTERVALS, SD = 0.25, 300, 1e-3


def henon_heiles(strength):
    """Hénon-Heiles motion with the cubic terms times a strength, by RK4."""

    def field(state):
        x, y, px, py = state.unbind(-1)
        return torch.stack((px, py, -x - 2 * strength * x * y, -y - strength * (x * x - y * y)), dim=-1)

    increment = partial(INTEGRATORS["rk4"].increment, field)
    return Trial(increment, partial(step_jacobians, increment), ROBUST["none"])


@torch.no_grad()
def test_a_segment_that_is_lost_from_its_old_start_is_fitted_again_over_growing_spans():
    """Over six Lyapunov times a change of 0.4 % moves the end beyond the linear range of the old start."""
    before, after = henon_heiles(1.004), henon_heiles(1.0)
    truth = 0.25 + 0.01 * torch.randn(4, 4, generator=generator(0), **DOUBLE)
    times = STEP * torch.arange(INTERVALS + 1, **DOUBLE).expand(len(truth), -1)
    steps = steps_between(times, STEP)
    states = path(after.exact, truth, steps.lengths)
    values = states + SD * torch.randn(states.shape, generator=generator(1), **DOUBLE)
    batch = Segment(values, times, Instrument(State(2), torch.full((4,), SD, **DOUBLE), STEP, 2, 1.0))
    old = fit_starts(before, truth, batch, steps).starts
    refined, found, best = (
        fitted.sums / batch.measured
        for fitted in (
            refine(after, old, batch, steps, FOLLOWING, SURE),
            follow_starts(after, old, batch, steps),
            refine(after, truth, batch, steps),
        )
    )
    lost = refined > WORSE
    assert int(lost.sum()) >= 2
    close(found[lost], best[lost], 1e-6)
    close(found[~lost], refined[~lost], 1e-12)
    assert 0.9 < float(best.mean()) < 1.1


@pytest.mark.parametrize("colour", [None, Colour(torch.full((4,), 0.6), torch.full((4,), 0.7))])
@torch.no_grad()
def test_weighted_residuals_and_derivatives_give_the_gradient_of_the_robust_cost(colour):
    """The gradient of half the cost is J^T r of the linearised rows, by differences of the starts."""
    trial = henon_heiles(1.0)._replace(robust=ROBUST["huber"])
    start, h = torch.tensor([[0.2, -0.1, 0.15, 0.1]], **DOUBLE), 1e-5
    times = STEP * torch.arange(9, **DOUBLE).unsqueeze(0)
    steps = steps_between(times, STEP)
    values = path(trial.exact, start, steps.lengths)
    values = values + 3 * SD * torch.randn(values.shape, generator=generator(2), **DOUBLE)
    instrument = Instrument(State(2), torch.full((4,), SD, **DOUBLE), STEP, 2, 1.0, colour=colour)
    batch = Segment(values, times, instrument)

    def half_cost(move):
        rows = batch.white_residuals(path(trial.exact, start + move, steps.lengths))
        return trial.robust.cost(rows).sum() / 2

    found = linearised(trial, path(trial.exact, start, steps.lengths), batch, steps)
    pull = torch.einsum("bkmd,bkm->d", found.of_start, found.residuals)
    units = h * torch.eye(4, **DOUBLE)
    slopes = torch.stack([(half_cost(move) - half_cost(-move)) / (2 * h) for move in units])
    close(pull, slopes, 1e-4)

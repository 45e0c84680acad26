"""Starts that follow a change of the dynamics: on a chaotic path the fit from the old start fails."""

from __future__ import annotations

from functools import partial

import torch
from helpers import close, generator
from oscillators import DOUBLE

from ahnn.integrators import INTEGRATORS
from ahnn.jacobians import step_jacobians
from ahnn.measurements import Instrument, Segment, State
from ahnn.shooting.initial_states import FOLLOWING, SURE, WORSE, Trial, fit_starts, follow_starts, refine
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

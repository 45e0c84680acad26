"""Test whether measurements show friction that a model lacks."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ahnn.evaluation.conservation import NOTABLE, PIECES, SURE, conserves
from ahnn.jacobians import step_jacobians
from ahnn.measurements import Segment
from ahnn.measurements.smoothing import guess
from ahnn.numbers import in_percent
from ahnn.rollouts import clock_of
from ahnn.shooting import initial_states
from ahnn.shooting.initial_states import FOLLOWING, LOST, Trial, fit_starts, refine
from ahnn.shooting.path_sensitivities import steps_between
from ahnn.shooting.robust import ROBUST

INTERVALS = 12
"""Number of intervals per segment, few enough for inaccurate dynamics to fit."""
MOST = 0.3
"""Minimum fraction of excess chi-square explained by friction; other errors may resemble it slightly."""
SMALL = 0.05
"""Decay of momenta over such a segment for which chi-square is compared."""


class FrictionTest(NamedTuple):
    """Additional friction indicated by measurements.

    Attributes:
        rate: decay rate of momenta in addition to the model, per unit of time.
        error: standard error of the rate.
        whole: relative decay over a trajectory.
        explains: fraction of the excess chi-square explained by this friction.
    """

    rate: float
    error: float
    whole: float
    explains: float

    @property
    def found(self) -> bool:
        """Whether additional decay or growth of momenta is significant and explains most of the excess."""
        sure = abs(self.rate) > SURE * self.error and abs(self.whole) > NOTABLE
        return sure and self.explains > MOST

    def sentence(self, unit: str) -> str:
        """Return the finding in words; "" without additional friction."""
        if not self.found:
            return ""
        per = "per unit of time" if unit == "1" else f"per {unit}"
        verb, remedy = ("decay", "forces=friction") if self.rate > 0 else ("grow", "forces=network")
        return (
            f"momenta {verb} by {in_percent(abs(self.rate))} {per} beyond the model, which has "
            f"no friction: add {remedy}"
        )


def friction_test(flow: Any, measured: Segment) -> FrictionTest | None:
    """Estimate the additional friction of measurements relative to a flow; None if inconclusive.

    On short segments with refitted initial states, chi-square is compared for slightly decaying, unchanged
    and slightly growing momenta. One Newton step yields the rate; the scatter of the segments' slopes at
    this rate yields its error.
    """
    if clock_of(flow) or not conserves(flow):
        return None
    short = shorter(measured, INTERVALS)
    short = short.rows(short.measured > 2 * short.instrument.dof)
    if len(short.times) < PIECES:
        return None
    steps = steps_between(short.times, short.instrument.longest)
    duration = float((short.times[:, -1] - short.times[:, 0]).median())
    small = SMALL / duration
    plain = fit_starts(decaying(flow, 0.0), guess(short), short, steps)
    kept = plain.sums <= LOST * short.measured
    if int(kept.sum()) < PIECES:
        return None
    short, steps, plain = short.rows(kept), steps.rows(kept), plain.rows(kept)
    less, more = (
        refine(decaying(flow, rate), plain.starts, short, steps, FOLLOWING, initial_states.SURE).sums
        for rate in (-small, small)
    )
    slopes, bends = (more - less) / (2 * small), (more - 2 * plain.sums + less) / small**2
    bend = bends.sum()
    if not bool(bend > 0):
        return None
    rate = float(-slopes.sum() / bend)
    error = float((slopes + bends * rate).square().sum().sqrt() / bend)
    span = float((measured.times.nan_to_num(nan=-torch.inf).amax(1) - measured.times[:, 0]).median())
    spent = float(short.measured.sum()) - 2.0 * short.instrument.dof * len(short.times)
    excess = max(float(plain.sums.sum()) - spent, 1.0)
    return FrictionTest(rate, error, rate * span, float(slopes.sum() ** 2 / (2 * bend)) / excess)


def decaying(flow: Any, rate: float) -> Trial:
    """Return the trial of a flow with an additional decay of the momenta at a given rate."""

    def increment(x: Tensor, dt: Tensor) -> Tensor:
        q, p = flow(x, dt).chunk(2, dim=-1)
        kept = torch.exp(-rate * torch.as_tensor(dt)).to(x)
        return torch.cat((q, p * (kept.unsqueeze(-1) if kept.ndim else kept)), dim=-1) - x

    return Trial(increment, partial(step_jacobians, increment), ROBUST["none"])


def shorter(segment: Segment, intervals: int) -> Segment:
    """Split trajectories into consecutive segments of a given number of intervals, without a remainder."""
    samples = intervals + 1
    count = segment.values.shape[1] // samples
    if count == 0:
        return segment
    values, times = (x[:, : count * samples] for x in (segment.values, segment.times))
    cut = values.reshape(-1, samples, values.shape[-1]), times.reshape(-1, samples)
    known = cut[1].isfinite().all(1)
    return segment._replace(values=cut[0][known], times=cut[1][known])

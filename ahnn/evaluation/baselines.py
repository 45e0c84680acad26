"""Baselines of a prediction: relative errors of persistence and of a linear map."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ahnn.evaluation.case import Case
from ahnn.numbers import in_percent
from ahnn.types import Trajectories

WORTHLESS = 0.9
"""Fraction of the better baseline's error above which a model is no better than that baseline."""
EXACT = 1e-4
"""Relative error below which differences between a model and a linear map do not matter."""
AT_FLOOR = 1.5
"""Multiple of the floor's error up to which a model is as accurate as perfect knowledge."""
PAIRS = 200_000
"""Approximate maximum number of steps to which a linear map is fitted."""


class Worth(NamedTuple):
    """Relative errors of prediction and baselines: rms in standard deviations of the data.

    The rms over samples and components is averaged over trajectories, as for the errors in the table.

    Attributes:
        model: error of the prediction.
        persistence: error of a constant state.
        linear: error of the best-fitting affine one-step map; None for unequal steps or without complete
            states.
        floor: error of the exact field with the model's integrator; None without known equations.
    """

    model: float
    persistence: float
    linear: float | None
    floor: float | None = None

    @property
    def below_linear(self) -> bool:
        """Whether a linear map is more accurate."""
        return self.linear is not None and WORTHLESS * self.model > max(self.linear, EXACT)

    @property
    def at_floor(self) -> bool:
        """Whether neither the exact equations nor a linear map is more accurate: chaos, or long steps."""
        return self.floor is not None and self.model <= AT_FLOOR * self.floor and not self.below_linear

    @property
    def worthless(self) -> bool:
        """Whether persistence, or the mean of the data, is as accurate."""
        return not self.at_floor and not self.model < WORTHLESS * min(1.0, self.persistence)

    def sentence(self) -> str:
        """Return the finding as a note under the table."""
        linear = "" if self.linear is None else f", a linear map {amount(self.linear)}"
        floor = f", the exact equations {amount(self.floor)}" if self.floor and self.at_floor else ""
        error = f"relative error {amount(self.model)} of the spread of the data"
        others = f"(persistence {amount(self.persistence)}{linear}{floor})"
        return (
            f"WORTHLESS: {error}, no better than without a model {others}"
            if self.worthless
            else f"{error} {others}"
        )

    def numbers(self) -> dict[str, Any]:
        """Return plain values for metrics.json."""
        return {**self._asdict(), "worthless": self.worthless, "below_linear": self.below_linear}


def amount(error: float) -> str:
    """Format a relative error in percent; a non-finite error is shown as infinite."""
    return in_percent(error) if error < 100 else "over 10,000 %" if math.isfinite(error) else "infinite"


def worth(case: Case, prediction: Tensor, floor: Tensor | None = None) -> Worth:
    """Compare a prediction (B, T, D) of the test trajectories of a case with the baselines.

    Unmeasured components are ignored. `floor` is the prediction of the exact field, if known.
    """
    truth = case.test.states
    still = truth[:, :1].expand_as(truth)
    mapped = linear_prediction(case)
    return Worth(
        relative_error(prediction, truth),
        relative_error(still, truth),
        *(None if known is None else relative_error(known, truth) for known in (mapped, floor)),
    )


def relative_error(prediction: Tensor, truth: Tensor) -> float:
    """Return the error of predictions (B, T, D), as in the table: the mean over trajectories of the rms.

    Components are divided by their standard deviations; a non-finite error is returned as infinity.
    """
    known = truth.isfinite()
    count = known.sum((0, 1))
    there = count > 0
    middle = truth.nanmean((0, 1))
    spread = torch.where(known, truth - middle, 0.0).square().sum((0, 1)) / count
    moving = there & (spread > 0)
    if not bool(moving.any()):
        return math.inf
    error = torch.where(known, prediction - truth, 0.0).square()[..., moving] / spread[moving]
    each = (error.sum((1, 2)) / known[..., moving].sum((1, 2))).sqrt()
    found = float(each.nanmean())
    return found if math.isfinite(found) and bool(prediction[known].isfinite().all()) else math.inf


def linear_prediction(case: Case) -> Tensor | None:
    """Predict with an affine one-step map, (B, T, D); None if it cannot be fitted.

    For controlled motion the map includes the controls.
    """
    if isinstance(case.dt, Tensor) or not bool(case.train.present.any()):
        return None
    before, after = pairs(case.train)
    size = case.test.states.shape[-1]
    if len(before) < before.shape[1] + 1:
        return None
    scale = before.abs().amax(0).clamp(min=1e-300)
    design = torch.cat((before / scale, torch.ones_like(before[:, :1])), dim=1)
    found = torch.linalg.lstsq(design, after, driver="gelsd").solution
    matrix, shift = found[:-1] / scale[:, None], found[-1]
    x = case.test.states[:, 0]
    along = [x]
    for k in range(case.test.states.shape[1] - 1):
        row = x if case.test.controls is None else torch.cat((x, case.test.controls[:, k]), dim=1)
        x = row[:, : len(matrix)] @ matrix + shift
        along.append(x)
    predicted = torch.stack(along, dim=1)
    return predicted if predicted.shape[-1] == size else None


def pairs(trajectories: Trajectories) -> tuple[Tensor, Tensor]:
    """Return states with controls at the beginning of steps, (R, D + m), and states at the end, (R, D)."""
    states, present = trajectories.states, trajectories.present
    chosen = (present[:, :-1] & present[:, 1:]).nonzero()
    b, k = chosen[:: max(1, len(chosen) // PAIRS)].T
    before = states[b, k]
    if trajectories.controls is not None:
        before = torch.cat((before, trajectories.controls[b, k]), dim=1)
    return before, states[b, k + 1]

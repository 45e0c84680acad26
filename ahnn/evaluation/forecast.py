"""Do forecasts keep what their bands promise? The second half of unseen measurements says it.

A start is fitted to the first half of each trajectory and predicts the second, as somebody would who knows
no more. It takes no truth; where that is known, true states are held against the bands, too.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics
from ahnn.evaluation.bands import NORMAL, SIGMAS
from ahnn.evaluation.explained import fit_to, trial_of, without_outliers
from ahnn.measurements import Segment
from ahnn.shooting.paths import path, steps_between
from ahnn.shooting.robust import RobustName
from ahnn.shooting.starts import LOST, linearised
from ahnn.types import Trajectories
from ahnn.uncertainty import forecast_variances


class Forecast(NamedTuple):
    """What the bands of forecasts were worth.

    Attributes:
        coverage: shares of the measured numbers ahead within 1, 2 and 3 standard deviations.
        width: these standard deviations, rms, in those of the noise alone.
        states: the same shares of the components of true states; None where these are not known.
        trajectories: how many were forecast.
    """

    coverage: tuple[float, ...]
    width: float
    states: tuple[float, ...] | None
    trajectories: int

    def sentence(self) -> str:
        """Return the finding as a note under the table."""
        text = (
            "forecast from the first half of unseen measurements, the second is within 1, 2 and 3 standard "
            f"deviations in {percent(self.coverage)} %"
        )
        return text + ("" if self.states is None else f", the true states in {percent(self.states)} %")

    def numbers(self) -> dict[str, Any]:
        """Return plain values for metrics.json."""
        return {"sigmas": list(SIGMAS), "of_normal_errors": list(NORMAL), **self._asdict()}


@torch.no_grad()
def forecast(
    dynamics: Dynamics,
    segment: Segment,
    spread: Tensor,
    robust: RobustName = "none",
    truth: Trajectories | None = None,
) -> Forecast | None:
    """Return what bands hold of the second halves of measurements, None where no first half can be fitted.

    Args:
        dynamics: with a field, float64.
        segment: measurements that the dynamics were not trained on.
        spread: L, shape (P, R); L L^T is the covariance of the parameters.
        robust: the loss of the training; one that weighs outliers down leaves them out here.
        truth: of the same trajectories, at these times and perhaps others.
    """
    if robust != "none":
        segment = without_outliers(dynamics, segment, robust)
    early = first_halves(segment)
    starts, met = fitted_to_first(dynamics, segment, early)
    if not bool(met.any()):
        return None
    starts, early, segment = starts[met], early[met], segment.rows(met)
    steps = steps_between(segment.times, segment.instrument.longest)
    states = path(dynamics.increment, starts, steps.lengths)
    here = linearised(trial_of(dynamics), states, segment, steps)
    of_states, of_values = forecast_variances(dynamics, starts, steps, here, early, spread)
    later, of_true = ~early.unsqueeze(-1), None
    if truth is not None:
        true = at(truth, met, segment.times)
        of_true = shares(((states[:, steps.ends] - true) / of_states.sqrt())[later & true.isfinite()])
    ahead = later & ~segment.values.isnan()
    return Forecast(
        coverage=shares((here.residuals / (1 + of_values).sqrt())[ahead]),
        width=float((1 + of_values)[ahead].nanmean().sqrt()),
        states=of_true,
        trajectories=len(starts),
    )


def first_halves(segment: Segment) -> Tensor:
    """Return which times belong to the first half of what was measured, (B, K + 1) bool."""
    there = ~segment.values.isnan().all(-1)
    return there.cumsum(1) <= there.sum(1, keepdim=True) / 2


def fitted_to_first(dynamics: Dynamics, segment: Segment, early: Tensor) -> tuple[Tensor, Tensor]:
    """Return the starts (B, D) that meet what was measured early, and which of them do, (B,) bool."""
    last = int(early.any(0).nonzero().amax())
    values = segment.values.masked_fill(~early.unsqueeze(-1), torch.nan)
    part = segment._replace(values=values).first(last)
    fitted, _ = fit_to(dynamics, part)
    met = (part.measured > 2 * part.instrument.dof) & (fitted.sums <= LOST * part.measured)
    return fitted.starts, met


def at(truth: Trajectories, rows: Tensor, times: Tensor) -> Tensor:
    """Return the states (b, K + 1, D) of some trajectories at some of their times, NaN beyond their end."""
    known, states = truth.times[rows].contiguous(), truth.states[rows]
    near = 1e-6 * float(known.diff(dim=1).nanmean())
    index = torch.searchsorted(known, (times - near).contiguous())
    states = torch.nn.functional.pad(states, (0, 0, 0, 1), value=torch.nan)
    return states.gather(1, index.unsqueeze(-1).expand(-1, -1, states.shape[-1]))


def shares(off: Tensor) -> tuple[float, ...]:
    """Return the shares within 1, 2 and 3 of errors in standard deviations; a NaN is outside."""
    return tuple(float((off.abs() <= k).double().mean()) for k in SIGMAS)


def percent(found: tuple[float, ...]) -> str:
    """Return shares as text."""
    return ", ".join(f"{100 * share:.3g}" for share in found)

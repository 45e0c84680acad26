"""Evaluation of chaotic motion: valid time of predictions in Lyapunov times, and long-term statistics.

No model follows a chaotic path indefinitely: errors grow by a factor e per Lyapunov time. Forecasts are
therefore evaluated by their valid time in that unit (Pathak et al. 2018, Phys. Rev. Lett. 120, 024102), and
beyond it by the distribution of visited states.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, final

import torch
from torch import Tensor

from ahnn.arguments import Count, Positive, checked
from ahnn.dynamics.flow_at_time import at
from ahnn.errors import UserError
from ahnn.evaluation import Case, Findings
from ahnn.jacobians import differenced
from ahnn.rollouts import rollout
from ahnn.systems import System, exact_flow
from ahnn.types import Flow, Space

__all__ = ["Chaos", "Horizons", "horizons", "lyapunov_exponents", "overlap"]

DIFFERENCE = 1e-5
"""Half-width of central differences, in standard deviations of a component."""
QUARTILES = (0.25, 0.5, 0.75)


class Horizons(NamedTuple):
    """Valid times of predictions.

    Attributes:
        times: (B,) times until the error exceeds the threshold; the whole duration if it never does.
        ended: (B,) bool, whether the error exceeds it.
    """

    times: Tensor
    ended: Tensor


@final
@checked
class Chaos:
    """Valid time of the prediction from the true start in Lyapunov times, and statistics beyond it.

    Args:
        threshold: largest error of a valid prediction, rms over components in standard deviations of the
        data.
        bins: number of histogram bins per component.
    """

    def __init__(self, threshold: Positive, bins: Count) -> None:
        self.threshold, self.bins = threshold, bins

    def check(self, truth: System | None, space: Space, steps: int) -> None:
        """Raise UserError for controlled motion, in which error growth also depends on the controls."""
        if space.controls:
            message = f"plugins.chaos: expected motion without controls; received {', '.join(space.controls)}"
            raise UserError(message)

    def __call__(self, case: Case) -> Findings:
        """Return valid times with quartiles, Lyapunov exponents with their mean, and the overlap."""
        truth = case.test.states
        if case.fitted is not None or isinstance(case.dt, Tensor) or not bool(case.test.present.all()):
            return Findings(numbers={}, notes=["chaos: needs full states at equal steps, without gaps"])
        flow = case.flow if case.truth is None else exact_flow(case.truth)
        clock = case.test.clock(getattr(case.flow, "clock", 0))
        prediction = rollout(case.flow, truth[:, 0], case.dt, truth.shape[1], clock=clock)
        spread = truth.std((0, 1))
        rates = lyapunov_exponents(flow, truth, case.test.times, case.dt, spread)
        found = horizons(prediction, truth, case.test.times, spread, self.threshold)
        late = truth.shape[1] // 2
        same = overlap(prediction[:, late:], truth[:, late:], self.bins)
        return findings(case.space.units.time, rates, found, same)


def findings(unit: str, rates: Tensor, found: Horizons, same: float) -> Findings:
    """Return the numbers, and a note for the table."""
    rate = float(rates.mean())
    lasting = int((~found.ended).sum())
    quartiles = [float(found.times.quantile(part)) for part in QUARTILES]
    numbers: dict[str, Any] = {
        "exponent": rate,
        "exponents": rates.tolist(),
        "horizons": found.times.tolist(),
        "horizon": quartiles,
        "horizon_in_lyapunov_times": [rate * time for time in quartiles],
        "not_ended": lasting,
        "trajectories": len(rates),
        "overlap": same,
    }
    low, middle, high = (rate * time for time in quartiles)
    more = f"; {lasting} of {len(rates)} are valid to the end" if lasting else ""
    note = (
        f"predictions are valid for a median of {middle:.2g} Lyapunov times, quartiles {low:.2g} and "
        f"{high:.2g} (one is {1 / rate:.3g} {unit}){more}; in the second half their distribution overlaps "
        f"{100 * same:.0f} % with the distribution of the true states"
        if rate > 0
        else "no error grows exponentially: the motion is not chaotic"
    )
    return Findings(numbers=numbers, notes=[note])


@torch.no_grad()
def lyapunov_exponents(flow: Flow, states: Tensor, times: Tensor, dt: float, spread: Tensor) -> Tensor:
    """Return the largest Lyapunov exponent along each trajectory, (B,), per unit of time.

    A deviation is propagated along the states by the step Jacobians and renormalised after each step
    (Benettin et al. 1980, Meccanica 15, 9).

    Args:
        flow: flow that is accurate to rounding.
        states: (B, T, D) states of the trajectories.
        times: (B, T) sample times.
        dt: step length.
        spread: (D,) unit of each component.
    """
    count, samples, size = states.shape
    draw = torch.Generator().manual_seed(0)
    along = torch.randn(count, size, generator=draw, dtype=torch.float64).to(states)
    along, growth = along / along.norm(dim=-1, keepdim=True), states.new_zeros(count)
    for k in range(samples - 1):
        from_here = at(flow, float(times[0, k]))
        jacobian = differenced(from_here, states[:, k], dt, DIFFERENCE * spread)[1]
        along = ((jacobian * spread / spread[:, None]) @ along.unsqueeze(-1)).squeeze(-1)
        size_now = along.norm(dim=-1, keepdim=True)
        growth, along = growth + size_now.squeeze(-1).log(), along / size_now
    return growth / (dt * (samples - 1))


def horizons(prediction: Tensor, truth: Tensor, times: Tensor, spread: Tensor, threshold: float) -> Horizons:
    """Return the times for which predictions (B, T, D) stay within a threshold of the truth."""
    error = ((prediction - truth) / spread).square().mean(-1).sqrt()
    beyond = ~(error <= threshold)
    ended = beyond.any(1)
    last = torch.where(ended, beyond.to(torch.int8).argmax(1), truth.shape[1] - 1)
    rows = torch.arange(len(times))
    return Horizons(times[rows, last] - times[:, 0], ended)


def overlap(prediction: Tensor, truth: Tensor, bins: int) -> float:
    """Return the mean overlap of histograms of predicted and true state components (..., D).

    The overlap is 1 for identical distributions and 0 for disjoint ones.
    """
    shared = []
    for ours, theirs in zip(prediction.flatten(0, -2).T, truth.flatten(0, -2).T, strict=True):
        low, high = float(theirs.min()), float(theirs.max())
        if not high > low:
            continue
        counts = [
            torch.histc(part.clamp(low, high)[(part >= low) & (part <= high)], bins, low, high) / len(part)
            for part in (ours.nan_to_num(nan=math.inf), theirs)
        ]
        shared.append(float(torch.minimum(*counts).sum()))
    return sum(shared) / len(shared) if shared else math.nan

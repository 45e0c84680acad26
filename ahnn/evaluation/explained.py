"""What can be said of learned dynamics without truth: do they explain measurements to within their noise?"""

from __future__ import annotations

import copy
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from ahnn.estimation.consistency import band
from ahnn.measurements import Segment
from ahnn.measurements.smoothing import guess
from ahnn.shooting.paths import Steps, steps_between
from ahnn.shooting.robust import ROBUST
from ahnn.shooting.starts import Fitted, Trial, fit_starts

NORMAL95 = 1.959963984540054
"""Standard deviations within which a normal number lies with 95 %."""
LOST = 25.0
"""Mean squared residual of a segment that its measurements were not met in."""


class Explained(NamedTuple):
    """How well paths from fitted starts explain measurements.

    Attributes:
        chi_square: squared residuals per degree of freedom, in standard deviations; 1 is the noise itself.
        band: within which it lies with 95 % if nothing but the noise is left.
        correlation: of residuals with those that follow; 0 if nothing but the noise is left.
        correlation_band: within which that lies with 95 %, on either side of 0.
        lost: trajectories that no start explains, which do not count in the others.
        trajectories: how many were tried.
    """

    chi_square: float
    band: tuple[float, float]
    correlation: float
    correlation_band: float
    lost: int
    trajectories: int

    @property
    def consistent(self) -> bool:
        """Whether nothing but the noise is left."""
        within = self.band[0] <= self.chi_square <= self.band[1]
        return within and abs(self.correlation) <= self.correlation_band and not self.lost

    def sentence(self) -> str:
        """Return the finding as a note under the table."""
        if self.lost == self.trajectories:
            return f"from no start does it meet the measurements of any of {self.lost} unseen trajectories"
        low, high = self.band
        text = (
            f"it leaves {self.chi_square:#.4g} of the noise's variance in unseen measurements "
            f"(1 to within {low - 1:+.1g} and {high - 1:+.1g}), "
            f"residuals in a row correlate by {self.correlation:+.1g}"
        )
        return text + (
            f"; {self.lost} of {self.trajectories} trajectories not explained" if self.lost else ""
        )

    def numbers(self) -> dict[str, Any]:
        """Return plain values for metrics.json."""
        return {**self._asdict(), "band": list(self.band), "consistent": self.consistent}


@torch.no_grad()
def fit_to(dynamics: nn.Module, segment: Segment) -> tuple[Fitted, Steps]:
    """Return the starts from which dynamics meet measurements best, and the steps of the paths from there.

    Args:
        dynamics: float64, with a method `increment`.
        segment: measurements that the dynamics were not trained on.
    """
    rough: Any = copy.deepcopy(dynamics).float()
    exact: Any = dynamics
    steps = steps_between(segment.times, segment.instrument.longest)
    trial = Trial(exact.increment, rough.increment, ROBUST["none"])
    return fit_starts(trial, guess(segment), segment, steps), steps


@torch.no_grad()
def explain(dynamics: nn.Module, segment: Segment) -> Explained:
    """Return how well dynamics explain measurements, each trajectory from the start that fits it best.

    Args:
        dynamics: float64, with a method `increment`.
        segment: measurements that the dynamics were not trained on.
    """
    fitted, steps = fit_to(dynamics, segment)
    degrees = segment.measured - 2 * segment.instrument.dof
    met = (degrees > 0) & (fitted.sums <= LOST * segment.measured)
    total = float(degrees[met].sum())
    chi = float(fitted.sums[met].sum()) / total if total else float("nan")
    part = segment.rows(met)
    residuals = part.residuals(fitted.states[met][:, steps.ends])
    correlation, pairs = serial(residuals.masked_fill(part.values.isnan(), torch.nan))
    # Residuals of a fit correlate by about minus the share of the numbers that it has spent on its unknowns.
    spent = 1 - total / float(part.measured.sum()) if total else 0.0
    return Explained(
        chi_square=chi,
        band=band(1, total) if total else (float("nan"), float("nan")),
        correlation=correlation,
        correlation_band=NORMAL95 / max(pairs, 1) ** 0.5 + spent,
        lost=int((~met).sum()),
        trajectories=len(met),
    )


def serial(residuals: Tensor) -> tuple[float, int]:
    """Return the correlation of residuals (B, K + 1, M) with those that follow, and of how many pairs.

    A NaN is no residual.
    """
    products = residuals[:, 1:] * residuals[:, :-1]
    return float(products.nanmean() / residuals.square().nanmean()), int(products.isfinite().sum())

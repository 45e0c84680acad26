"""Goodness of fit: whether learned dynamics explain measurements to within their noise."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor, nn

from ahnn.dynamics.base import Dynamics, has_field
from ahnn.dynamics.variations import own_jacobians
from ahnn.estimation.consistency import band
from ahnn.jacobians import step_jacobians
from ahnn.measurements import Segment
from ahnn.measurements.smoothing import guess
from ahnn.numbers import if_few, in_percent
from ahnn.shooting.initial_states import FOLLOWING, LOST, SURE, Fitted, Trial, fit_starts, refine
from ahnn.shooting.path_sensitivities import Steps, steps_between
from ahnn.shooting.robust import ROBUST, Robust, RobustName, loss_of

NORMAL95 = 1.959963984540054
"""Half-width of the central 95 % of a normal distribution, in standard deviations."""
PARTIAL = 4
"""A model that does not fit one in so many trajectories is too poor for a diagnosis of the noise."""
COARSE = 3.0
"""Factor by which shorter steps reduce the chi-square of trajectories not fitted if they are the cause.

Halved steps of a method of order p reduce it by 4^p.
"""
OUTLYING = 6.0
"""Number of standard deviations beyond which a value is an outlier, if training used a robust loss."""


class Explained(NamedTuple):
    """Goodness of fit of paths from fitted initial states.

    Attributes:
        chi_square: chi-square of the residuals per degree of freedom; 1 for pure noise.
        band: 95 % interval for pure noise.
        correlation: serial correlation of residuals; 0 for pure noise.
        correlation_band: half-width of its 95 % interval about 0.
        lost: number of trajectories that cannot be fitted, excluded from all other values.
        trajectories: number of trajectories tried.
        outliers: fraction of measured values excluded as outliers.
        halved_steps: the same chi-square with steps of half the length; None without a field.
        gain: factor by which steps of half the length reduce the chi-square of the trajectories not fitted;
            NaN if all diverge, None without such trajectories or without a field.
    """

    chi_square: float
    band: tuple[float, float]
    correlation: float
    correlation_band: float
    lost: int
    trajectories: int
    outliers: float = 0.0
    halved_steps: float | None = None
    gain: float | None = None

    @property
    def consistent(self) -> bool:
        """Whether residuals are consistent with pure noise."""
        within = self.band[0] <= self.chi_square <= self.band[1]
        return within and abs(self.correlation) <= self.correlation_band and not self.lost

    @property
    def is_partial(self) -> bool:
        """Whether so many trajectories cannot be fitted that residuals do not show the noise."""
        return self.lost * PARTIAL >= self.trajectories

    @property
    def is_coarse(self) -> bool:
        """Whether shorter steps change the chi-square, or fit what longer ones do not, beyond chance."""
        low, high = self.band
        changed = (
            self.halved_steps is not None and abs(self.halved_steps - self.chi_square) > (high - low) / 2
        )
        return changed or (self.gain is not None and self.gain > COARSE)

    def sentence(self) -> str:
        """Return the finding as a note under the table."""
        if self.lost == self.trajectories:
            what = f"any of {self.lost} unseen trajectories"
            return f"no initial state fits the measurements of {what}{self._steps()}"
        low, high = self.band
        digits = max(1, math.ceil(-math.log10(max(high - low, 1e-9) / 2))) if high > low else 1
        text = (
            f"residuals of unseen measurements{if_few(self.trajectories)} have "
            f"{self.chi_square:#.4g} times the noise variance ({low:.{digits}f} to {high:.{digits}f} if the "
            f"model is right), and successive residuals correlate by {self.correlation:+.1g}"
        )
        text += f"; {in_percent(self.outliers)} excluded as outliers" if self.outliers else ""
        text += f"; {self.lost} of {self.trajectories} trajectories not fitted" if self.lost else ""
        return text + self._steps()

    def _steps(self) -> str:
        """Return the remark on steps that are too long; "" if they are not."""
        if not self.is_coarse:
            return ""
        found = (
            f"paths of trajectories not fitted have residuals {self.gain**0.5:.2g} times smaller"
            if self.gain is not None and self.gain > COARSE
            else f"{self.halved_steps:#.4g} times"
        )
        return (
            f"; with steps of half the length {found}: the integrator's error is not negligible compared "
            "with the noise; use an integrator of higher order, up to dopri8, or shorter steps, such as "
            "data.stride=0.25 for four per sample"
        )

    def numbers(self) -> dict[str, Any]:
        """Return plain values for metrics.json."""
        return {**self._asdict(), "band": list(self.band), "consistent": self.consistent}


def trial_of(dynamics: nn.Module, robust: Robust = ROBUST["none"]) -> Trial:
    """Return the trial of float64 dynamics that have a method `increment`."""
    increment = cast(Any, dynamics).increment
    known = isinstance(dynamics, Dynamics)
    jacobians = own_jacobians(dynamics) if known else partial(step_jacobians, increment)
    return Trial(increment, jacobians, robust)


@torch.no_grad()
def fit_to(dynamics: nn.Module, segment: Segment, robust: RobustName = "none") -> tuple[Fitted, Steps]:
    """Fit initial states to measurements; return them and the steps of their paths.

    Args:
        dynamics: float64 dynamics with an `increment` method.
        segment: measurements not used in training.
        robust: robust loss of residuals; unused for Student's noise, which has its own likelihood.
    """
    steps = steps_between(segment.times, segment.instrument.longest)
    trial = trial_of(dynamics, loss_of(robust, segment.instrument.freedom))
    return fit_starts(trial, guess(segment), segment, steps), steps


@torch.no_grad()
def without_outliers(dynamics: nn.Module, segment: Segment, robust: RobustName) -> Segment:
    """Return measurements without outliers (`cleaned`)."""
    return segment if robust == "none" else cleaned(segment, *fit_to(dynamics, segment, robust), robust)


def cleaned(segment: Segment, fitted: Fitted, steps: Steps, robust: RobustName) -> Segment:
    """Return measurements without those far from a robustly fitted path; Student's noise has no outliers.

    If at least half of the values of a trajectory are far, the path is wrong, and the values are kept.
    """
    if robust == "none" or segment.instrument.freedom is not None:
        return segment
    far = segment.residuals(fitted.states[:, steps.ends]).abs() > OUTLYING
    explained = far.flatten(1).sum(-1) < segment.measured / 2
    far = far & explained.view(-1, 1, 1)
    return segment._replace(values=segment.values.masked_fill(far, torch.nan))


def outlier_fraction(before: Segment, after: Segment) -> float:
    """Return the fraction of the measured values that are missing after the exclusion of outliers."""
    return 1 - int(after.measured.sum()) / max(int(before.measured.sum()), 1)


@torch.no_grad()
def explain(dynamics: nn.Module, segment: Segment, robust: RobustName = "none") -> Explained:
    """Compute the goodness of fit, with each trajectory starting from its best initial state.

    Args:
        dynamics: float64 dynamics with an `increment` method.
        segment: measurements not used in training.
        robust: robust loss of the training; with one, outliers are excluded.
    """
    given, segment = segment, without_outliers(dynamics, segment, robust)
    fitted, steps = fit_to(dynamics, segment)
    degrees = segment.measured - 2 * segment.instrument.dof
    met = (degrees > 0) & (fitted.sums <= LOST * segment.measured)
    total = float(degrees[met].sum())
    part, halved, gain = segment.rows(met), None, None
    residuals = part.scores(fitted.states[met][:, steps.ends])
    chi = float(residuals.square().sum()) / total if total else float("nan")
    if has_field(dynamics):
        if total:
            again, half = with_halved_steps(dynamics, part, fitted.rows(met), steps.rows(met))
            halved = float(part.scores(again.states[:, half.ends]).square().sum()) / total
        if not met.all():
            far = fitted.rows(~met)
            again, _ = with_halved_steps(dynamics, segment.rows(~met), far, steps.rows(~met))
            followed = far.sums.isfinite() & again.sums.isfinite()
            gain = float(far.sums[followed].sum() / again.sums[followed].sum())
    correlation, pairs = serial(residuals.masked_fill(part.values.isnan(), torch.nan))
    # After a fit, successive residuals correlate by about minus the number of unknowns per value.
    spent = 1 - total / float(part.measured.sum()) if total else 0.0
    return Explained(
        chi_square=chi,
        band=band(1, total) if total else (float("nan"), float("nan")),
        correlation=correlation,
        correlation_band=NORMAL95 / max(pairs, 1) ** 0.5 + spent,
        lost=int((~met).sum()),
        trajectories=len(met),
        outliers=outlier_fraction(given, segment),
        halved_steps=halved,
        gain=gain,
    )


def with_halved_steps(
    dynamics: nn.Module, segment: Segment, fitted: Fitted, steps: Steps
) -> tuple[Fitted, Steps]:
    """Refine initial states that were fitted with longer steps; return them and the steps."""
    half = steps.halved()
    trial = trial_of(dynamics, loss_of("none", segment.instrument.freedom))
    return refine(trial, fitted.starts, segment, half, FOLLOWING, SURE), half


def serial(residuals: Tensor, apart: int = 1) -> tuple[float, int]:
    """Return the correlation of residuals (B, K + 1, M) at a time lag, and the number of pairs.

    NaN values are ignored.
    """
    products = residuals[:, apart:] * residuals[:, :-apart]
    return float(products.nanmean() / residuals.square().nanmean()), int(products.isfinite().sum())

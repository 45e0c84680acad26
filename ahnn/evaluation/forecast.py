"""Coverage of forecast bands by measurements: a calibration check without truth.

An initial state is fitted to the first half of each unseen trajectory and predicts the second half. If the
truth is known, true states are also compared with the bands.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics, HasField
from ahnn.evaluation.bands import NORMAL, SIGMAS, percent
from ahnn.evaluation.forecast_variances import Variances, middle
from ahnn.evaluation.goodness_of_fit import OUTLYING, fit_to, trial_of, without_outliers
from ahnn.evaluation.independent_directions import TOO_FEW
from ahnn.evaluation.sampled_forecast import sampled_errors
from ahnn.measurements import Segment
from ahnn.measurements.student_noise import normal_scores
from ahnn.numbers import if_few, in_percent
from ahnn.shooting.initial_states import FOLLOWING, LOST, SURE, linearised, refine
from ahnn.shooting.path_sensitivities import Steps, path, steps_between
from ahnn.shooting.quadrature import coarse
from ahnn.shooting.robust import RobustName, informative, loss_of
from ahnn.types import Trajectories
from ahnn.uncertainty import LINEAR, asymmetry, forecast_columns, nonlinearity

HALF = 0.5
"""Fraction of the measurements of a trajectory to which the start of its forecast is fitted."""
PARTS = (0.2, 0.4, 1.0)
"""Fractions of the forecast after which it is also tested separately."""


class PartialCoverage(NamedTuple):
    """Coverage of some true states by forecast bands.

    Attributes:
        states: fractions of the states within 1, 2 and 3 standard deviations; None if there are none.
        parts: these fractions after each of `PARTS` of the forecast.
    """

    states: tuple[float, ...] | None
    parts: tuple[tuple[float, ...] | None, ...]


class Forecast(NamedTuple):
    """Coverage of forecast bands.

    Attributes:
        coverage: fractions of the forecast measurements within 1, 2 and 3 standard deviations.
        width: rms of these standard deviations, relative to the noise; if close to 1, little but the noise
            was tested.
        parameters: mean fraction of the variance of forecast states due to the parameters.
        states: the same fractions for components of true states; None if these are unknown.
        right: range of the coverage of calibrated bands in the central 95 % of draws.
        lost: number of trajectories whose first half no start fits; all other values exclude them.
        trajectories: number of trajectories tried.
        outliers: fraction of the measured values that were excluded as outliers.
        single: errors of the true states of the first trajectory after `PARTS` of its forecast, in standard
            deviations; None if these are unknown.
        parts: coverage of the true states of all trajectories after each of these parts.
        nonlinear: fraction of the forecast states whose index of nonlinearity exceeds `LINEAR`.
        linear: coverages of the true states within the linear range; None if these are unknown.
        sampled: coverages of all true states, with sampled paths beyond that range; None if not requested.
    """

    coverage: tuple[float, ...]
    width: float
    parameters: float
    states: tuple[float, ...] | None
    right: tuple[tuple[float, float], ...]
    lost: int
    trajectories: int
    outliers: float = 0.0
    single: tuple[tuple[float, ...], ...] | None = None
    parts: tuple[tuple[float, ...], ...] | None = None
    nonlinear: float = 0.0
    linear: PartialCoverage | None = None
    sampled: PartialCoverage | None = None

    def sentence(self) -> str:
        """Return the finding as a note under the table."""
        text = (
            f"forecasts of second halves of unseen trajectories ({self.trajectories - self.lost}) from first "
            f"halves: bands of 1, 2 and 3 standard deviations, rms {self.width:.3g} times the noise, contain "
            f"{percent(self.coverage)} % of the measured values"
        )
        if self.states is not None:
            text += (
                f" and {percent(self.states)} % of the true states ({right_bands(self.states, self.right)})"
            )
        text += f"; the parameters contribute {in_percent(self.parameters)} of the variance of a state"
        if self.nonlinear:
            text += f"; the errors of {in_percent(self.nonlinear)} of the states do not propagate linearly"
        text += f"; {in_percent(self.outliers)} excluded as outliers" if self.outliers else ""
        return text + (f"; first halves not fitted: {self.lost}" if self.lost else "")

    def verdict(self) -> str:
        """Return the coverage of the bands, for the verdict."""
        return (
            f"bands: {100 * self.coverage[1]:.3g} % of unseen measurements"
            f"{if_few(self.trajectories - self.lost)} lie within 2 standard deviations of their forecast "
            f"({100 * NORMAL[1]:.3g} % if the bands are right)"
        )

    def numbers(self) -> dict[str, Any]:
        """Return plain values for metrics.json."""
        word = "" if self.states is None else judged(self.states, self.right)
        found = {"sigmas": list(SIGMAS), "of_normal_errors": list(NORMAL), **self._asdict(), "verdict": word}
        parts = {"linear": self.linear, "sampled": self.sampled}
        return found | {name: part._asdict() for name, part in parts.items() if part is not None}


@torch.no_grad()
def forecast(
    dynamics: Dynamics,
    segment: Segment,
    spread: Tensor,
    robust: RobustName = "none",
    truth: Trajectories | None = None,
    fitted: float = HALF,
    samples: int = 0,
) -> Forecast | None:
    """Evaluate forecast bands on second halves of measurements; None if no first half can be fitted.

    Args:
        dynamics: float64 dynamics with a field.
        segment: measurements not used in training.
        spread: L, shape (P, R); L L^T is the covariance of the parameters.
        robust: robust loss of the training. With one, outliers are excluded: in the first half values far
            from the robust fit, in the second half values far from the forecast.
        truth: true states of the trajectories, at these and possibly other times.
        fitted: fraction of the measurements of a trajectory to which its start is fitted.
        samples: number of sampled paths that judge states beyond the linear range; 0: none.
    """
    early = first_part(segment, fitted)
    first = part_fitted(dynamics, segment, early, robust)
    begun, _ = fit_to(dynamics, first)
    met = (first.measured > 2 * first.instrument.dof) & (begun.sums <= LOST * first.measured)
    if not bool(met.any()):
        return None
    starts, early, first, part = begun.starts[met], early[met], first.rows(met), segment.rows(met)
    freedom, loss = part.instrument.freedom, informative(part.instrument.freedom)
    states, steps = resolved_path(dynamics, starts, first, part)
    here = linearised(trial_of(dynamics, loss), states, part, steps)
    there = ~early.unsqueeze(-1).expand_as(states[:, steps.ends])
    true = None if truth is None else at(truth, met, part.times)
    there = there if true is None else there & true.isfinite()
    causes = forecast_columns(dynamics, states, steps, here, early, spread, part.whitening)
    of_state = here.of_state / loss.weight(torch.ones_like(part.values)).sqrt().unsqueeze(-1)
    begin = max(int(early.sum(1).min()) - 1, 0)
    variances = Variances.of(causes, of_state, there, spread.shape[1], begin)
    beyond = interval_nonlinearity(dynamics, states, steps, variances) > LINEAR
    known: dict[str, Any] = {"states": None}
    if true is not None:
        off_true = (states[:, steps.ends] - true) / variances.states.sqrt()
        known = true_coverages(off_true, there, beyond, early)
        if samples:
            drawn = sampled_errors(dynamics, states, steps, variances, spread, true, begin, samples)
            known["sampled"] = partial(torch.where(beyond.unsqueeze(-1), drawn, off_true), there, early)
    ahead, total = ~early.unsqueeze(-1) & ~part.values.isnan(), 1 + variances.values
    width, off = total[ahead], errors(part, states[:, steps.ends], variances.values)[ahead]
    counted = ~(off.abs() > OUTLYING) | (robust == "none" or freedom is not None)
    return Forecast(
        coverage=fractions(off[counted]),
        width=float(width[counted].nanmean().sqrt()),
        parameters=float((variances.parameters / variances.states)[ahead.any(-1)].nanmean()),
        right=middle(variances.within / int(there.sum())),
        lost=int((~met).sum()),
        trajectories=len(met),
        outliers=1 - float(counted.double().mean()),
        nonlinear=float(beyond[ahead.any(-1)].double().mean()),
        **known,
    )


def errors(part: Segment, states: Tensor, variances: Tensor) -> Tensor:
    """Return errors of forecasts in standard deviations; `variances` (B, K + 1, M) exclude the noise."""
    rows, freedom = part.residuals(states), part.instrument.freedom
    return rows / (1 + variances).sqrt() if freedom is None else normal_scores(rows, freedom, variances)


def true_coverages(off: Tensor, there: Tensor, beyond: Tensor, early: Tensor) -> dict[str, Any]:
    """Return the fields of a `Forecast` on the coverage of true states by first-order bands.

    Args:
        off: errors of the true states in standard deviations, (B, K + 1, D).
        there: mask of forecast states, (B, K + 1, D).
        beyond: mask of times beyond the linear range, (B, K + 1).
        early: mask of fitted times, (B, K + 1).
    """
    known = after_parts(off, early)
    return {
        "states": fractions(off[there]),
        "single": tuple(tuple(row) for row in known[0].tolist()),
        "parts": tuple(fractions(row[row.isfinite()]) for row in known.unbind(1)),
        "linear": partial(off, there & ~beyond.unsqueeze(-1), early),
    }


def interval_nonlinearity(dynamics: Dynamics, states: Tensor, steps: Steps, variances: Variances) -> Tensor:
    """Return the index of nonlinearity of forecasts at the times of measurements, (B, K + 1)."""
    ends = steps.ends.tolist()

    def flow(k: int, x: Tensor) -> Tensor:
        lengths = steps.lengths[:, ends[k] : ends[k + 1]].repeat(len(x), 1)
        return path(dynamics.increment, x.flatten(0, 1), lengths)[:, -1].view_as(x)

    return nonlinearity(asymmetry(flow, states[:, steps.ends], variances.moves), variances.states.sqrt())


def partial(off: Tensor, counted: Tensor, early: Tensor) -> PartialCoverage:
    """Return the coverage of some states.

    Args:
        off: errors of the true states in standard deviations, (B, K + 1, D).
        counted: mask of these states, (B, K + 1, D).
        early: mask of fitted times, (B, K + 1).
    """
    rows = after_parts(off.masked_fill(~counted, torch.nan), early).unbind(1)
    found = [row[row.isfinite()] for row in (off[counted], *rows)]
    every, *parts = [fractions(row) if len(row) else None for row in found]
    return PartialCoverage(every, tuple(parts))


def right_bands(fractions: tuple[float, ...], right: tuple[tuple[float, float], ...]) -> str:
    """Format the coverage of calibrated bands and the conclusion; only the latter if it is undecided."""
    verdict = judged(fractions, right)
    if verdict == TOO_FEW:
        return verdict
    ends = ", ".join(f"{100 * low:.3g} to {100 * high:.3g}" for low, high in right)
    return f"calibrated bands {ends} % in 19 of 20 draws: {verdict}"


def judged(fractions: tuple[float, ...], right: tuple[tuple[float, float], ...]) -> str:
    """Return a verdict on the coverage within 2 sigma; undecided if half the width would also pass."""
    low, high = right[1]
    if low <= NORMAL[0]:
        return TOO_FEW
    return "too narrow" if fractions[1] < low else "too wide" if fractions[1] > high else "right"


def first_part(segment: Segment, fraction: float) -> Tensor:
    """Return the mask of times in the first part of the measurements, (B, K + 1) bool."""
    there = ~segment.values.isnan().all(-1)
    return there.cumsum(1) <= there.sum(1, keepdim=True) * fraction


def after_parts(values: Tensor, early: Tensor) -> Tensor:
    """Return the values (B, K + 1, D) at the ends of `PARTS` of the times after early ones, (B, 3, D)."""
    first, samples = early.sum(1, keepdim=True), early.shape[1]
    ends = first + ((samples - first) * torch.tensor(PARTS, dtype=torch.float64)).ceil().long() - 1
    return values.gather(1, ends.unsqueeze(-1).expand(-1, -1, values.shape[-1]))


def part_fitted(dynamics: Dynamics, segment: Segment, early: Tensor, robust: RobustName) -> Segment:
    """Return the measurements at early times (B, K + 1), cut after the last of them, without outliers."""
    last = max(int(early.any(0).sum()) - 1, 1)
    part = segment._replace(values=segment.values.masked_fill(~early.unsqueeze(-1), torch.nan)).first(last)
    return without_outliers(dynamics, part, robust)


def resolved_path(dynamics: Dynamics, starts: Tensor, first: Segment, part: Segment) -> tuple[Tensor, Steps]:
    """Return the path over a segment and its steps; if they are coarse, quarters with refitted starts.

    Args:
        dynamics: float64 dynamics with a field.
        starts: (B, D) states that fit the first measurements.
        first: the first measurements.
        part: all measurements.
    """
    steps = steps_between(part.times, part.instrument.longest)
    states = path(dynamics.increment, starts, steps.lengths)
    if not coarse(cast(HasField, dynamics).field, states, steps.lengths):
        return states, steps
    steps = steps.quarters()
    trial = trial_of(dynamics, loss_of("none", part.instrument.freedom))
    starts = refine(trial, starts, first, steps.first(first.times.shape[1] - 1), FOLLOWING, SURE).starts
    return path(dynamics.increment, starts, steps.lengths), steps


def at(truth: Trajectories, rows: Tensor, times: Tensor) -> Tensor:
    """Return the states (b, K + 1, D) of trajectories at times (b, K + 1), NaN where missing."""
    known = truth.times[rows].nan_to_num(nan=torch.inf)
    near = 1e-6 * float(truth.times.diff(dim=1).nanmean())
    index = torch.searchsorted(known, times - near).clamp(max=known.shape[1] - 1)
    same = (known.gather(1, index) - times).abs() <= near
    states = truth.states[rows].gather(1, index.unsqueeze(-1).expand(-1, -1, truth.states.shape[-1]))
    return states.masked_fill(~same.unsqueeze(-1), torch.nan)


def fractions(off: Tensor) -> tuple[float, ...]:
    """Return the fractions of normalised errors within 1, 2 and 3; NaN counts as outside."""
    return tuple(float((off.abs() <= k).double().mean()) for k in SIGMAS)

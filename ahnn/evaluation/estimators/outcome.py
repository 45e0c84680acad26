"""Outcome of one filter in one scenario: estimates, consistency, table rows, numbers."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.batch_least_squares import BatchResult
from ahnn.estimation.belief import Status
from ahnn.estimation.consistency import (
    GAUSSIAN,
    band,
    coverage,
    deviations,
    nees,
    share_within,
)
from ahnn.estimation.consistency_bands import Judged, judged_nees, judged_nis, nis_at_times
from ahnn.estimation.estimator import Smoothed
from ahnn.estimation.results import FilterResult
from ahnn.estimation.scenario import Problem, Setting
from ahnn.estimation.state import initial_state
from ahnn.evaluation import Case, Row, Who
from ahnn.evaluation.titles import title
from ahnn.labels import quantity
from ahnn.metrics import Scores
from ahnn.types import Space

BATCH = "batch_least_squares"


class Outcome(NamedTuple):
    """Outcome of a filter, or its smoother, on the test trajectories of one scenario.

    Attributes:
        who: identity of the row with the scores over the entire arc.
        estimate: (B, T + 1, D) after updates, the start first; NaN for a failed member.
        chol: (B, T + 1, D, D) lower factors of the filter's covariance.
        nees: (B, T + 1) normalised estimation error squared.
        first: index of the first updated sample.
        result: filter result.
        more: additional numbers of this estimator, for metrics.json.
    """

    who: Who
    estimate: Tensor
    chol: Tensor
    nees: Tensor
    first: int
    result: FilterResult
    more: dict[str, Any] = {}  # noqa: RUF012 - never written to

    @property
    def lost(self) -> int:
        """Number of members whose status is not OK."""
        return int((self.result.status != Status.OK).sum())


def filtered(who: Who, setting: Setting, problem: Problem, result: FilterResult) -> Outcome:
    """Build the outcome of a filter."""
    return _outcome(who, (result.means, result.chols), setting, problem, result)


def smoothed(
    who: Who, setting: Setting, problem: Problem, result: FilterResult, name: str, found: Smoothed
) -> Outcome:
    """Build the outcome of a named smoother after a filter."""
    behind, (beliefs, more) = who._replace(estimator=f"{who.estimator}_{name}"), found
    result = result._replace(initial=beliefs.initial, backward=None)
    return _outcome(behind, (beliefs.means, beliefs.chols), setting, problem, result)._replace(more=more)


def fitted(who: Who, setting: Setting, problem: Problem, fit: BatchResult) -> Outcome:
    """Build the outcome of batch least squares, which has no innovations."""
    initial, means, chols, cost, measured, status, settled = fit
    nothing = torch.full_like(problem.measurements, torch.nan)
    result = FilterResult(
        initial=initial,
        means=means,
        chols=chols,
        predicted_means=means,
        predicted_chols=chols,
        innovations=nothing,
        nis=nothing[..., 0],
        measured=measured,
        rejected=torch.zeros_like(measured, dtype=torch.bool),
        log_likelihood=nothing[:, 0, 0],
        status=status,
        failed_step=torch.where(status == Status.OK, -1, 0),
        repairs=torch.zeros_like(status),
        backward=None,
        state=initial_state(initial),
    )
    outcome = _outcome(who._replace(estimator=BATCH), (means, chols), setting, problem, result)
    there = status == Status.OK
    more = {
        "chi_square_per_number": float(cost[there].sum() / measured[there].sum().clamp(min=1)),
        "unsettled": int((~settled & there).sum()),
    }
    return outcome._replace(more=more)


def _outcome(
    who: Who, moments: tuple[Tensor, Tensor], setting: Setting, problem: Problem, result: FilterResult
) -> Outcome:
    means, chols = moments
    estimate = torch.cat((result.initial.mean[:, None], means), dim=1)
    chol = torch.cat((result.initial.chol[:, None], chols), dim=1)
    measured = (result.measured > 0).any(0).nonzero().flatten().tolist()
    # Scheduled measurements may have been out of view.
    first = measured[0] + 1 if measured else setting.first
    return Outcome(who, estimate, chol, nees(estimate - problem.truth, chol), first, result)


def rows(outcome: Outcome, case: Case, without: Scores | None, floor: Scores | None = None) -> list[Row]:
    """Return the rows of an outcome: over the entire arc, and after the first update.

    Args:
        outcome: outcome of a filter.
        case: evaluated case.
        without: scores from the same start without a filter, for a remark on a worse filter; None: no remark.
        floor: scores of this estimator with the exact flow, for the reason of the remark; None if unknown.
    """
    whole, extra = case.score(outcome.estimate), {"lost": outcome.lost}
    settled = case.score(outcome.estimate, outcome.first)
    return [
        Row(outcome.who, whole, _remark(outcome, whole, (without, floor), case.space), extra),
        Row(outcome.who._replace(span="settled"), settled, _consistency_remark(outcome, case), extra),
    ]


def name(outcome: Outcome, case: Case) -> str:
    """Return the name of an outcome in figures."""
    return title(outcome.who, case.label)


def _remark(
    outcome: Outcome, whole: Scores, others: tuple[Scores | None, Scores | None], space: Space
) -> str:
    """Return remarks on members that failed or had no measurements, and on a filter worse than prediction."""
    remarks = []
    if outcome.lost:
        codes = {Status(int(s)).name.lower().replace("_", " ") for s in outcome.result.status if int(s)}
        remarks.append(f"{outcome.lost} of {len(outcome.nees)} lost ({', '.join(sorted(codes))})")
    unmeasured = int((outcome.result.measured == 0).all(-1).sum())
    if unmeasured:
        remarks.append(f"{unmeasured} of {len(outcome.nees)} without any measurement")
    if outcome.more.get("unsettled"):
        remarks.append(f"{outcome.more['unsettled']} of {len(outcome.nees)} have not settled")
    without, floor = others
    worse = [] if without is None else _worse(whole, without, space)
    if worse:
        mean, (low, high) = _nees(outcome)
        if outcome.lost:
            reason = "lost members"
        elif outcome.who.start == "true" and mean <= high:
            reason = "the start is exact, measurements are not"
        elif not low <= mean <= high:
            reason = "overconfident" if mean > high else "cautious"
        else:
            also = _worse(floor, without, space) if floor and without else worse
            reason = "measurement noise" if {*worse} & {*also} else "the model or its process noise"
        where = "" if len(worse) == 2 else f" in {worse[0]}"
        remarks.append(f"worse than no filter{where}: {reason}")
    return "; ".join(remarks)


def _worse(scores: Scores, without: Scores, space: Space) -> list[str]:
    """Return the quantities, among position and velocity, that a filter makes worse."""
    names = ("position", "velocity")
    return [quantity(space, n)[0] for n in names if not getattr(scores, n) <= getattr(without, n)]


def _consistency_remark(outcome: Outcome, case: Case) -> str:
    """Return a remark on mean NEES and NIS relative to their bands, after the first update.

    Also includes the mean NEES of each phase of the motion in which it is outside the band.
    """
    if not bool((outcome.result.measured > 0).any()):
        return "nothing was measured"
    if outcome.lost == len(outcome.nees):
        return ""
    exact, overall, nis = outcome.who.start == "true", _nees(outcome), judged_nis(outcome.result)
    say = Judged.of_exact_starts if exact else str
    parts = [f"NEES {say(overall)}"]
    if not math.isnan(nis.mean):
        parts.append(f"NIS {say(nis)}")
    low = exact and any(one.mean < one.limits[0] for one in (overall, nis))
    phases = _phases(outcome, case).items()
    parts += [
        f"NEES {name} {mean}"
        for name, mean in phases
        if not (mean.inside or (exact and mean.mean < mean.limits[0]))
    ]
    return ", ".join(parts) + (", low because the start is exact" if low else "")


def _nees(outcome: Outcome) -> Judged:
    """Return the mean NEES over members and times after the first update."""
    return judged_nees(outcome.nees[:, outcome.first :], outcome.estimate.shape[-1])


def _phases(outcome: Outcome, case: Case) -> dict[str, Judged]:
    """Return the mean NEES, after the first update, in each phase of the motion that occurs."""
    if case.truth is None:
        return {}
    first, size = outcome.first, outcome.estimate.shape[-1]
    judged = {}
    for phase, part in case.truth.phases(case.test.states).items():
        values = outcome.nees.masked_fill(~part, torch.nan)[:, first:]
        if bool(values.isfinite().any()):
            judged[phase] = judged_nees(values, size)
    return judged


def numbers(outcome: Outcome, case: Case) -> dict[str, Any]:
    """Return the metrics.json entry of an outcome as plain values.

    Means are over trajectories and over times after the first update; `band_95` is the 95 % band of such a
    mean for a consistent filter. `in_band` is the fraction of times at which the mean over trajectories is
    within its band: `one_time_band_95` for the NEES; for the NIS it depends on the number of measured values.
    `nees_of_phases` is the NEES by `System.phases`, `nees_of_start` the NEES at time zero.
    """
    result, first = outcome.result, outcome.first
    error = outcome.estimate - case.test.states
    after = slice(first, None)
    members = len(outcome.nees) - outcome.lost
    one_time = band(error.shape[-1], members)
    kept = result.nis.masked_fill(result.rejected, torch.nan)
    at_times, low, high = nis_at_times(kept, result.measured)
    within = ((at_times >= low) & (at_times <= high))[at_times.isfinite()]
    fractions = coverage(error[:, after], deviations(outcome.chol[:, after]))
    return {
        "whole_arc": case.score(outcome.estimate)._asdict(),
        "from_first_update": case.score(outcome.estimate, first)._asdict(),
        "nees": _plain(_nees(outcome))
        | {
            "one_time_band_95": list(one_time),
            "in_band": share_within(outcome.nees[:, after].nanmean(0), one_time),
        },
        "nees_of_start": _plain(judged_nees(outcome.nees[:, :1], error.shape[-1])),
        "nees_of_phases": {name: _plain(mean) for name, mean in _phases(outcome, case).items()},
        "nis": _plain(judged_nis(result)) | {"in_band": float(within.double().mean())},
        "coverage": {f"{k}_sigma": {"fraction": fractions[k], "gaussian": p} for k, p in GAUSSIAN.items()},
        "status": {status.name: int((result.status == status).sum()) for status in Status},
        "failed_steps": result.failed_step[result.failed_step >= 0].tolist(),
        "repairs": int(result.repairs.sum()),
        "rejected_measurements": int(result.rejected.sum()),
        "log_likelihood": float(result.log_likelihood.mean()),
        **outcome.more,
    }


def _plain(judged: Judged) -> dict[str, Any]:
    return {"mean": judged.mean, "band_95": list(judged.limits)}

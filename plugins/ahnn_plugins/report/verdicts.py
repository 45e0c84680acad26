"""Verdicts on claims from runs: a claim holds, does not hold, or is undecided.

A claim is a set of demands, each of which requires that the ratio of two scores lies in an interval. It holds
if the confidence interval of every ratio lies inside: each at the confidence level of the report, without
correction, since all must pass (an intersection-union test). It does not hold if the confidence interval of
any ratio lies entirely outside, with the error probability divided by the number of demands (Bonferroni),
since a single one suffices. Otherwise it is undecided.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

from ahnn_plugins.report.score_samples import Ratio, Sample, ratio
from ahnn_plugins.report.scores import Measure

Answer = Literal["holds", "does not hold", "undecided", "not tested"]


class Demand(NamedTuple):
    """Demand that the ratio of two scores lies from `low` to `high`."""

    one: Measure
    other: Measure
    low: float
    high: float


class Claim(NamedTuple):
    """Claim of the paper.

    Attributes:
        name: anchor name.
        system: system of the claim.
        text: paraphrased claim.
        source: location in the paper.
        demands: demands that must be met.
    """

    name: str
    system: str
    text: str
    source: str
    demands: tuple[Demand, ...]


class Evidence(NamedTuple):
    """Evidence on a demand from the runs and from the paper's numbers.

    Attributes:
        demand: demand under test.
        ratio: ratio of the runs, with confidence interval; None if a score is missing.
        refuted: whether the ratio lies outside the required interval, at the required confidence.
        runs: number of runs behind numerator and denominator.
        paper: ratio of the paper's printed numbers, or None.
    """

    demand: Demand
    ratio: Ratio | None
    refuted: bool
    runs: tuple[int, int]
    paper: float | None

    @property
    def met(self) -> bool:
        """Whether the confidence interval lies within the demanded one."""
        return self.ratio is not None and self.ratio.within(self.demand.low, self.demand.high)

    @property
    def supported(self) -> bool:
        """Whether the paper's own ratio lies within the required interval."""
        return self.paper is not None and self.demand.low <= self.paper <= self.demand.high


class Verdict(NamedTuple):
    """Verdict on a claim, with evidence and, if undecided, the reason."""

    claim: Claim
    answer: Answer
    evidence: tuple[Evidence, ...]
    reason: str = ""


def judged(
    claim: Claim,
    scores: Callable[[Measure], Sample],
    paper: Callable[[Measure], float | None],
    confidence: float,
) -> Verdict:
    """Evaluate a claim from samples of scores.

    Args:
        claim: claim to evaluate.
        scores: function from a measure to its sample, possibly empty.
        paper: function from a measure to the paper's number, or None.
        confidence: confidence level, such as 0.95.
    """
    strict = 1 - (1 - confidence) / len(claim.demands)
    found = []
    for demand in claim.demands:
        one, other = scores(demand.one), scores(demand.other)
        there = bool(one.values and other.values)
        refuted = there and ratio(one, other, strict).beyond(demand.low, demand.high)
        runs = len(one.values), len(other.values)
        a, b = paper(demand.one), paper(demand.other)
        own = None if a is None or b is None else a / b
        found.append(Evidence(demand, ratio(one, other, confidence) if there else None, refuted, runs, own))
    return Verdict(claim, answer(found), tuple(found), _reason(found))


def answer(evidence: list[Evidence]) -> Answer:
    """Combine all evidence into an answer."""
    if all(each.ratio is None for each in evidence):
        return "not tested"
    if any(each.refuted for each in evidence):
        return "does not hold"
    return "holds" if all(each.met for each in evidence) else "undecided"


def _reason(evidence: list[Evidence]) -> str:
    """Return the reason for an undecided claim; "" if decided."""
    if answer(evidence) in ("holds", "does not hold"):
        return ""
    missing = {m for e in evidence if not all(e.runs) for m, n in _counted(e) if not n}
    if missing:
        names = sorted({f"{m.model} with the filter" if m.filtered else m.model for m in missing})
        return f"no scores of {', '.join(names)}"
    if any(min(each.runs) < 2 for each in evidence):
        return "a single run of a model has no spread; more seeds are needed"
    lost = any(each.ratio is not None and each.ratio.value != each.ratio.value for each in evidence)
    return "predictions of some runs are lost" if lost else "the seeds differ too much"


def _counted(evidence: Evidence) -> list[tuple[Measure, int]]:
    return [(evidence.demand.one, evidence.runs[0]), (evidence.demand.other, evidence.runs[1])]

"""What the runs say of a claim: it holds, it does not hold, or their spread leaves it undecided.

A claim is a set of demands, each that the ratio of two scores lies in an interval. It holds if the whole
confidence interval of every ratio does: each at the level of the report, which needs no correction, since
all must pass (an intersection-union test). It does not hold if that of some ratio lies outside entirely, at
the level divided by the number of demands (Bonferroni), since any one may fail it. All else is undecided.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

from ahnn_plugins.report.score_samples import Ratio, Sample, ratio
from ahnn_plugins.report.scores import Measure

Answer = Literal["holds", "does not hold", "undecided", "not tested"]


class Demand(NamedTuple):
    """That one score over another lies from `low` to `high`."""

    one: Measure
    other: Measure
    low: float
    high: float


class Claim(NamedTuple):
    """A statement of the paper.

    Attributes:
        name: anchor.
        system: that it is about.
        text: what is said, in our words.
        source: where the paper says it.
        demands: what must be so for it to hold.
    """

    name: str
    system: str
    text: str
    source: str
    demands: tuple[Demand, ...]


class Evidence(NamedTuple):
    """What the runs and the paper's own numbers say of a demand.

    Attributes:
        demand: the demand.
        ratio: of the runs, with its confidence interval; None where a score is missing.
        refuted: whether the ratio lies outside what is demanded, with the confidence that this takes.
        runs: number of runs behind numerator and denominator.
        paper: ratio of the numbers that the paper prints; None where it prints none.
    """

    demand: Demand
    ratio: Ratio | None
    refuted: bool
    runs: tuple[int, int]
    paper: float | None

    @property
    def met(self) -> bool:
        """Whether the whole interval lies in what is demanded."""
        return self.ratio is not None and self.ratio.within(self.demand.low, self.demand.high)

    @property
    def supported(self) -> bool:
        """Whether the paper's own numbers lie in it."""
        return self.paper is not None and self.demand.low <= self.paper <= self.demand.high


class Verdict(NamedTuple):
    """The answer to a claim, with its evidence and why it is no clearer."""

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
    """Return what samples of scores say of a claim.

    Args:
        claim: to be judged.
        scores: sample of a measure, empty where there is none.
        paper: number of the paper, None where there is none.
        confidence: such as 0.95.
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
    """Return the answer of all evidence."""
    if all(each.ratio is None for each in evidence):
        return "not tested"
    if any(each.refuted for each in evidence):
        return "does not hold"
    return "holds" if all(each.met for each in evidence) else "undecided"


def _reason(evidence: list[Evidence]) -> str:
    """Return why a claim is not decided; "" where it is."""
    if answer(evidence) in ("holds", "does not hold"):
        return ""
    missing = {m for e in evidence if not all(e.runs) for m, n in _counted(e) if not n}
    if missing:
        names = sorted({f"{m.model} with the filter" if m.filtered else m.model for m in missing})
        return f"no scores of {', '.join(names)}"
    if any(min(each.runs) < 2 for each in evidence):
        return "one run of a model has no spread to judge by; more seeds decide"
    lost = any(each.ratio is not None and each.ratio.value != each.ratio.value for each in evidence)
    return "predictions of some runs are lost" if lost else "the seeds differ too much"


def _counted(evidence: Evidence) -> list[tuple[Measure, int]]:
    return [(evidence.demand.one, evidence.runs[0]), (evidence.demand.other, evidence.runs[1])]

"""Page on the paper's claims: verdicts, numbers and confidence."""

from __future__ import annotations

import math
from collections import Counter

from ahnn_plugins.report.claims import CLAIMS
from ahnn_plugins.report.collection import Collection
from ahnn_plugins.report.grid import NONE, Cell, Grid, Head, Line, interval, shown
from ahnn_plugins.report.layout import grid_html
from ahnn_plugins.report.markup import Markup, tag
from ahnn_plugins.report.paper import filtered
from ahnn_plugins.report.paper_tables import is_of_paper
from ahnn_plugins.report.scores import Board, Measure, board
from ahnn_plugins.report.verdicts import Answer, Demand, Evidence, Verdict, judged

SIGNS: dict[Answer, str] = {"holds": "✓", "does not hold": "✗", "undecided": "?", "not tested": "–"}


def verdicts(collection: Collection, confidence: float) -> list[Verdict]:
    """Return the verdicts on the paper's claims for the available systems."""
    boards = {system: board(collection, system) for system in collection.systems()}
    there = {system: each for system, each in boards.items() if is_of_paper(each)}
    return [_judged(claim, there[claim.system], confidence) for claim in CLAIMS if claim.system in there]


def _judged(claim, scores: Board, confidence: float) -> Verdict:
    def paper(measure: Measure) -> float | None:
        found = scores.printed(measure)
        return None if found is None else found.value

    return judged(claim, scores.sample, paper, confidence)


def tally(found: list[Verdict]) -> Markup:
    """Return the number of claims by verdict."""
    counts = Counter(verdict.answer for verdict in found)
    items = [tag("li", badge(answer), f" {counts[answer]}") for answer in SIGNS if counts[answer]]
    return tag("ul", items, class_="tally")


def badge(answer: Answer) -> Markup:
    """Return a verdict as a word with a sign, so that it does not depend only on colour."""
    sign = tag("span", SIGNS[answer], aria_hidden="true")
    return tag("span", sign, " ", answer, class_=f"badge {answer.replace(' ', '-')}")


def claims_table(system: str, found: list[Verdict], confidence: float) -> Grid:
    """Return the claims about a system with their verdicts, one per line."""
    lines = [
        Line(verdict.claim.text, (Cell(verdict.answer, "words"), *_ratios(verdict.evidence)))
        for verdict in found
    ]
    return Grid(
        f"claims_{system}",
        f"{system}: claims of the paper.",
        f"The first ratio of each claim: ours, with its {confidence:.0%} interval, and the paper's.",
        ((Head("Claim"), Head("Verdict"), Head("Ours"), Head("Paper")),),
        tuple(lines),
    )


def _ratios(evidence: tuple[Evidence, ...]) -> tuple[Cell, Cell]:
    first = evidence[0]
    ours = NONE if first.ratio is None else interval(first.ratio)
    return Cell(ours), Cell(NONE if first.paper is None else shown(first.paper), "quiet")


def claims_html(found: list[Verdict], confidence: float) -> Markup:
    """Return all claims of a system."""
    return tag("div", [_claim(verdict, confidence) for verdict in found], class_="claims")


def _claim(verdict: Verdict, confidence: float) -> Markup:
    claim = verdict.claim
    supported = sum(each.supported for each in verdict.evidence)
    own = f"The paper's own numbers meet {supported} of {len(verdict.evidence)} demands."
    met = sum(each.met for each in verdict.evidence)
    refuted = sum(each.refuted for each in verdict.evidence)
    ours = f"Ours meet {met} and contradict {refuted}."
    because = f" Undecided: {verdict.reason}." if verdict.answer == "undecided" else ""
    head = tag(
        "summary", badge(verdict.answer), " ", claim.text, " ", tag("span", claim.source, class_="source")
    )
    said = tag("p", f"{ours} {own}{because}")
    return tag("details", head, said, grid_html(evidence_table(verdict, confidence)), id=claim.name)


def evidence_table(verdict: Verdict, confidence: float) -> Grid:
    """Return the table of the numbers that a verdict is based on."""
    lines = [Line(_named(each.demand), _cells(each)) for each in verdict.evidence]
    names = ("demanded", f"ours [{confidence:.0%}]", "runs", "paper", "verdict")
    return Grid(
        f"{verdict.claim.name}-numbers",
        "Evidence.",
        "Ratios of geometric means over seeds, with confidence interval.",
        ((Head("Ratio"), *map(Head, names)),),
        tuple(lines),
    )


def _named(demand: Demand) -> str:
    one, other = demand.one, demand.other
    start = f"{one.start} start" if one.start == other.start else f"{one.start} / {other.start} start"
    return f"{_model(one)} / {_model(other)}, {one.quantity}, {start}"


def _model(measure: Measure) -> str:
    return filtered(measure.model) if measure.filtered else measure.model


def _cells(each: Evidence) -> tuple[Cell, ...]:
    low, high = each.demand.low, each.demand.high
    wanted = f"below {high:.3g}" if low == 0 else f"{low:.3g} to {high:.3g}"
    if math.isinf(high):
        wanted = f"above {low:.3g}"
    answer = "holds" if each.met else "does not hold" if each.refuted else "undecided"
    return (
        Cell(wanted),
        Cell(NONE if each.ratio is None else interval(each.ratio)),
        Cell(f"{each.runs[0]}, {each.runs[1]}"),
        Cell(NONE if each.paper is None else shown(each.paper), "quiet"),
        Cell("not tested" if each.ratio is None else answer, "words"),
    )

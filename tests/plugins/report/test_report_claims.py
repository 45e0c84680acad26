"""The paper's numbers are read whole, and verdicts on its claims follow from the runs alone."""

from __future__ import annotations

import math

import pytest

from ahnn_plugins.report.claims import CLAIMS
from ahnn_plugins.report.paper import COLUMNS, MODELS, PaperCell, filtered, printed, read_numbers
from ahnn_plugins.report.score_samples import Sample
from ahnn_plugins.report.scores import Measure
from ahnn_plugins.report.verdicts import Claim, Demand, judged

HEAD = ",".join(COLUMNS) + "\n"
ROW = "table1_mass_spring,MLP,true_initial,rmse_position,0.009173,m\n"


def test_the_paper_prints_ninety_numbers_and_each_doubt_is_about_one_of_them():
    numbers = printed()
    assert len(numbers) == 2 * 40 + 2 * 5
    assert numbers[PaperCell("mass_spring", "AHNN5", True, "perturbed", "velocity")].value == 3.7685e-4
    assert numbers[PaperCell("molniya", "NODE", False, "perturbed", "position")].value == 14374e2
    assert numbers[PaperCell("molniya", "AHNN5", False, "true", "velocity")].doubt.endswith(
        "ten times too large"
    )
    assert numbers[PaperCell("molniya", "HNN", False, "true", "energy")].unit == "km²/s²"
    assert not numbers[PaperCell("mass_spring", "MLP", False, "true", "position")].doubt
    assert [filtered(m) for m in MODELS] == ["MLPKF", "NODEKF", "HNNKF", "AHNNKF3", "AHNNKF5"]


@pytest.mark.parametrize(
    "text",
    [
        "a,b\n",
        HEAD + "x\n",
        HEAD + ROW + ROW,
        HEAD + ROW.replace("0.009173", "-1"),
        HEAD + ROW.replace("0.009173", "nan"),
        HEAD + ROW.replace("0.009173", "much"),
        HEAD + ROW.replace("MLP", "RNN"),
        HEAD + ROW.replace("rmse_position", "rmse_colour"),
        HEAD + ROW.replace("true_initial", "late"),
    ],
)
def test_a_damaged_table_of_the_paper_is_refused(text):
    assert len(read_numbers(HEAD + ROW)) == 1
    with pytest.raises(ValueError, match=r"expected|could not convert"):
        read_numbers(text)


def paper(claim):
    def number(measure):
        found = printed().get(
            PaperCell(claim.system, measure.model, measure.filtered, measure.start, measure.quantity)
        )
        return None if found is None else found.value

    return number


# What the paper's tables say of its own text, worked out by hand from the printed cells.
CONTRADICTED = {
    "spring-filter-best",  # NODEKF has the lowest velocity from the true start
    "orbit-hnn",  # velocity: 3.3635 / 1.3516 = 2.5
    "orbit-ahnn",  # velocity: 1.3516 / 0.45962 = 2.9
    "orbit-best",  # velocity: AHNN3 0.06476 is below AHNN5 0.45962
    "orbit-filter",  # velocity of HNNKF is above HNN
    "orbit-filter-hnn",  # position: 470.09 / 42.35 = 11
    "orbit-filter-alike",  # position: 470.09 is below 1733
}


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.name)
def test_runs_that_find_the_papers_numbers_confirm_its_claims_but_those_its_tables_contradict(claim):
    number = paper(claim)
    found = judged(claim, lambda m: Sample(tuple(number(m) * f for f in (0.999, 1.0, 1.001))), number, 0.95)
    assert (found.answer == "does not hold") == (claim.name in CONTRADICTED)
    assert (found.answer == "holds") == (claim.name not in CONTRADICTED)
    for each in found.evidence:
        assert each.met == each.supported
        assert each.runs == (3, 3)


A, B = Measure("A"), Measure("B")
BELOW = Claim("x", "s", "A is below B", "", (Demand(A, B, 0.0, 1.0),))


def verdict(one, other, claim=BELOW):
    samples = {"A": Sample(tuple(one)), "B": Sample(tuple(other))}
    return judged(claim, lambda m: samples[m.model], lambda _: None, 0.95)


def test_a_claim_holds_fails_or_is_open_as_the_spread_over_seeds_has_it():
    assert verdict((1.0, 1.1, 1.05), (2.0, 2.2, 2.1)).answer == "holds"
    assert verdict((2.0, 2.2, 2.1), (1.0, 1.1, 1.05)).answer == "does not hold"
    wide = verdict((1.0, 3.0, 0.5), (2.0, 1.2, 4.1))
    assert (wide.answer, wide.reason) == ("undecided", "the seeds differ too much")


def test_one_seed_decides_nothing_and_missing_runs_are_named():
    assert "more seeds" in verdict((1.0,), (9.0,)).reason
    assert verdict((1.0,), (9.0,)).answer == "undecided"
    assert verdict((), (1.0, 2.0)).answer == "not tested"
    two = Claim("x", "s", "", "", (*BELOW.demands, Demand(B, B, 0.0, 2.0)))
    assert verdict((), (1.0, 1.0), two).reason == "no scores of A"
    assert verdict((), (1.0, 1.0), two).answer == "undecided"
    assert verdict((1.0, math.inf), (1.0, 1.0)).reason == "predictions of some runs are lost"


def test_one_of_many_demands_is_only_refuted_with_the_confidence_that_their_number_takes():
    one, other = (1.3, 1.42, 1.5), (1.0, 1.1, 1.2)
    many = Claim("x", "s", "", "", (BELOW.demands[0], *[Demand(A, B, 0.0, 1e9)] * 19))
    assert verdict(one, other).answer == "does not hold"
    assert verdict(one, other, many).answer == "undecided"


def test_claims_have_names_of_their_own_and_speak_of_models_of_the_paper():
    assert len({claim.name for claim in CLAIMS}) == len(CLAIMS)
    for claim in CLAIMS:
        assert claim.demands
        for demand in claim.demands:
            assert demand.low < demand.high
            assert {demand.one.model, demand.other.model} <= {*MODELS}

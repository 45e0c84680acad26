"""The verdict on a model: a grade by its error, faults before highlights, five findings at most."""

from __future__ import annotations

import pytest
from cases import make_case

from ahnn.evaluation import evaluate
from ahnn.evaluation.baselines import Worth
from ahnn.evaluation.publish import make_results
from ahnn.evaluation.score_table import results_table
from ahnn.evaluation.verdict import verdict


@pytest.mark.parametrize(
    ("error", "noisy", "head"),
    [(0.009, False, "good: "), (0.05, False, "fair: "), (0.2, False, "poor: "), (0.2, True, "good: ")],
)
def test_the_grade_is_that_of_the_error_unless_noise_is_part_of_it(error, noisy, head):
    (line,) = verdict(Worth(error, 1.5, None), [], [], noisy=noisy)
    assert line.startswith(head)
    (line, fault) = verdict(Worth(error, 1.5, None), ["add forces=friction"], [], noisy=noisy)
    assert line.startswith("not good: ")
    assert fault == "add forces=friction"


def test_a_worthless_model_is_called_so_and_no_more_than_five_findings_are_shown():
    found = verdict(Worth(1.2, 1.1, None), ["a", "b", "c"], ["d", "e"], noisy=False)
    assert found[0].startswith("WORTHLESS")
    assert found[1:4] == ["a", "b", "c"]
    assert found[4] == "2 more findings: evaluation.detail=true shows them"
    assert verdict(Worth(1.2, 1.1, None), ["a", "b"], ["c", "d"], noisy=False)[1:] == ["a", "b", "c", "d"]


def test_the_table_ends_with_the_verdict_and_with_all_notes_on_request(tmp_path):
    findings = evaluate(make_case(tmp_path), {})
    results = make_results(make_case(tmp_path), findings, {}, {})
    told = results.numbers["verdict"]["findings"]
    assert told
    brief, whole = results_table(results), results_table(results, detail=True)
    assert " ".join(told[0].split()) in " ".join(brief.split())
    assert "pooled" in whole
    assert "pooled" not in brief
    before = results_table(results._replace(numbers={}))  # of an earlier version
    assert " ".join(results.rows[0].note.splitlines()[0].split()) in " ".join(before.split())

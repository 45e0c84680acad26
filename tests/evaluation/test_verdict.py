"""The verdict on a model: a grade by its error, faults before highlights, five findings at most."""

from __future__ import annotations

import pytest
from cases import make_case

from ahnn.cli.compose import compose_job
from ahnn.cli.prepare import prepare
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


@pytest.mark.parametrize(
    ("worth", "head"),
    [
        (Worth(0.0095, 1.4, 5e-5), "worse than a linear map: relative error 0.95 %"),  # linear motion
        (Worth(5e-5, 1.4, 1e-9), "good: "),  # both exact
        (Worth(0.46, 1.52, 0.35), "worse than a linear map: relative error 46 %"),
        (Worth(0.36, 1.52, 0.35), "poor: "),
        (Worth(0.95, 1.4, 0.2), "WORTHLESS: "),
        (Worth(0.3, 1.4, 0.9, 0.25), "good: "),  # chaos: as the exact equations
        (Worth(0.95, 1.4, 1.1, 0.9), "good: "),
        (Worth(0.3, 1.4, 0.9, 0.01), "poor: "),
        (Worth(0.3, 1.4, 0.01, 0.3), "worse than a linear map: "),  # a floor of long steps
    ],
)
def test_a_model_is_judged_by_persistence_a_linear_map_and_the_floor(worth, head):
    (line,) = verdict(worth, [], [], noisy=False)
    assert line.startswith(head)
    assert ("without a model" in line) == worth.worthless == (head == "WORTHLESS: ")
    assert ("the exact equations" in line) == worth.at_floor
    faulty = verdict(worth, ["add forces=friction"], [], noisy=False)[0]
    assert worth.worthless or faulty.startswith("not good")
    assert ("worse than a linear map" in faulty) == (worth.below_linear and not worth.worthless)


def test_general_advice_is_given_only_where_no_finding_says_more():
    advised = [verdict(Worth(1.2, 1.1, None), *more, noisy=False)[0] for more in (([], ["a"]), (["b"], []))]
    assert [line.endswith("Train longer, or use another model") for line in advised] == [True, False]
    smoke = verdict(
        Worth(1.2, 1.1, None), ["add forces=friction"], [], noisy=False, caveat="budget=smoke only"
    )
    assert smoke[1:] == ["budget=smoke only", "add forces=friction"]
    assert "Train longer" not in verdict(Worth(1.2, 1.1, None), [], [], noisy=False, caveat="budget=smoke")[0]


def test_a_good_model_disproves_a_caveat():
    given = {"noisy": False, "caveat": "budget=smoke only"}
    assert verdict(Worth(1e-4, 1.1, None), [], [], **given)[1:] == []
    assert verdict(Worth(1e-4, 1.1, None), ["a"], [], **given)[1:] == ["budget=smoke only", "a"]
    assert verdict(Worth(0.05, 1.1, None), [], [], **given)[1:] == ["budget=smoke only"]


def test_a_longer_smoke_run_is_a_training_and_tensorboard_compares_its_noise_and_forces(tmp_path):
    texts = ["system=pendulum", "budget=smoke"]
    epochs = prepare(compose_job(texts, tmp_path), None, texts).trainer.max_epochs
    longer = [*texts, f"trainer.max_epochs={epochs + 1}", "data.noise=0.01", "recipe=measurements"]
    longer += ["forces=friction", "data.trajectories=21"]
    found = prepare(compose_job(longer, tmp_path), None, longer)
    assert found.caveat == ""
    expected = {"data.noise": 0.01, "forces": "friction", "data.trajectories": 21}
    assert found.searched.items() >= expected.items()


@pytest.mark.parametrize("asked", [["budget=smoke"], []])
def test_a_smoke_run_says_that_it_only_checks_the_installation(tmp_path, asked):
    texts = ["system=pendulum", *asked]
    caveat = prepare(compose_job(texts, tmp_path), None, texts).caveat
    told = evaluate(make_case(tmp_path, caveat=caveat), {}, figures=False).numbers["verdict"]["findings"]
    assert any(line.startswith("budget=smoke only checks") for line in told[1:2]) == bool(asked)


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
    for text in (brief, whole):
        assert " ".join(text.split()).count(" ".join(told[0].split())) == 1
    assert " ".join(whole.split()).count("of the spread of the data") == 1
    assert "pooled" in whole
    assert "pooled" not in brief
    before = results_table(results._replace(numbers={}))  # of an earlier version
    assert " ".join(results.rows[0].note.splitlines()[0].split()) in " ".join(before.split())

"""The table of a sweep takes the model's row by its identity and shows W beside the loss."""

from __future__ import annotations

import io
import math

import pytest
from cases import MODEL, make_results, scores
from rich.console import Console

from ahnn.evaluation import Row, Who
from ahnn.evaluation.results import write_results
from ahnn.evaluation.sweep_summary import PRUNED, OverrideCell, rounded, sweep_table
from ahnn.evaluation.terminal import show


@pytest.fixture
def sweep(tmp_path):
    """Four jobs: scores among decoys, a lost model of another W, a damaged file, and nothing."""
    jobs = [tmp_path / str(number) for number in range(4)]
    for job in jobs:
        (job / ".hydra").mkdir(parents=True)
        (job / ".hydra" / "overrides.yaml").write_text(
            f"- window={job.name}\n- model=ahnn\n- data.windows_per_epoch=5000\n- a=[b]\n"
            f"- trial={{_target_:a.b,storage:'journal:///of mine,\n  folded',trial_id:{job.name}}}\n"
            f"- hydra.sweep.subdir='{job.name}'\n"
        )
    decoys = [
        Row(Who("exact field, rk4", "true", floor=True), scores(7.7)),
        Row(MODEL._replace(start="perturbed"), scores(8.8)),
        Row(MODEL._replace(estimator="ukf"), scores(9.9)),
    ]
    training = {"window": 5, "val_loss": 1e-9, "seconds": 12.25}
    first = make_results(*decoys, Row(MODEL, scores(1.25, 2.5)), training=training)
    write_results(jobs[0], first)
    other = make_results(Row(MODEL, scores(math.inf, None)), training={"window": 1, "val_loss": 0.5})
    write_results(jobs[1], other)
    (jobs[2] / "metrics.json").write_text("{")
    return tmp_path, jobs


def test_each_job_has_its_row(sweep, capsys):
    show(sweep_table(*sweep))
    out = capsys.readouterr().out
    lines = [line.split() for line in out.splitlines()]
    assert max(map(len, out.splitlines())) <= 80
    jobs = [line for line in lines if line and line[0] in ("0", "1", "2", "3")]
    assert ["all", "jobs:", "model=ahnn", "data.windows_per_epoch=5000", "a=[b]"] in lines
    assert jobs[0] == ["0", "window=0", "5", "12.2", "1.00e-09", "1.25", "1.25", "2.50"]
    assert jobs[1] == ["1", "window=1", "1", "-", "0.500", "inf", "inf", "-"]
    for line in jobs[2:]:
        assert line[1:] == [f"window={line[0]}", *["-"] * 5, "no", "scores"]


@pytest.mark.parametrize("varied", ["seed", "window"])
def test_units_are_stated_and_seeds_lead_to_their_report(sweep, varied):
    folder, jobs = sweep
    for job in jobs:
        (job / ".hydra" / "overrides.yaml").write_text(f"- {varied}={job.name}\n- model=ahnn\n")
    caption = str(sweep_table(folder, jobs).caption)
    assert "Scores: true start, in m, m/s, J." in caption
    assert (f"Means and spreads over seeds: python -m ahnn.report {folder}" in caption) == (varied == "seed")


@pytest.mark.parametrize(("other", "window", "told"), [(0.1, 5, True), (0.2, 5, False), (0.1, 3, False)])
def test_a_least_loss_beside_a_far_smaller_error_is_said(sweep, capsys, other, window, told):
    """Job 0 with an error of 1.25 has the least loss; job 3 has a tenth of it or less, or another window."""
    folder, jobs = sweep
    better = make_results(Row(MODEL, scores(other, 1.0)), training={"window": window, "val_loss": 1e-8})
    write_results(jobs[3], better)
    show(sweep_table(folder, [jobs[0], jobs[3]]))
    out = " ".join(capsys.readouterr().out.split())
    assert ("Job 0 has the least val loss, but 12 times the error of job 3" in out) is told


def test_numbers_are_rounded_and_lines_break_between_overrides(sweep, capsys):
    folder, jobs = sweep
    drawn = ["model.network.width=16", "optimizer.lr=0.026460534159839705", "seed=1234567"]
    drawn += ["scheduler.infimum_lr=4.1256046816885525e-06"]
    for job in jobs:
        (job / ".hydra" / "overrides.yaml").write_text(
            "".join(f"- {text}\n" for text in [*drawn, f"w={job.name}"])
        )
    (jobs[3] / ".hydra" / "overrides.yaml").write_text("- w=3\n")
    show(sweep_table(folder, jobs))
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 80
    words = out.split()
    for text in ("optimizer.lr=0.02646", "seed=1234567"):
        assert words.count(text) == 3


@pytest.mark.parametrize(
    ("width", "lines"),
    [
        (60, ["model.network.width=16 optimizer.lr=0.02646"]),
        (24, ["model.network.width=16", "optimizer.lr=0.02646"]),
        (20, ["model.network.width=", "  16", "optimizer.lr=0.02646"]),
    ],
)
def test_no_number_is_broken(width, lines):
    console = Console(width=width, file=io.StringIO())
    console.print(OverrideCell(["model.network.width=16", "optimizer.lr=0.02646"]))
    assert [line.rstrip() for line in console.file.getvalue().splitlines()] == lines


@pytest.mark.parametrize(
    ("override", "shown"),
    [
        ("a=0.026460534159839705", "a=0.02646"),
        ("a=-4.1256046816885525e-06", "a=-4.126e-06"),
        ("a=123456789", "a=123456789"),
        ("a=0.1", "a=0.1"),
        ("a=[0.123456]", "a=[0.123456]"),
        ("model=hnn", "model=hnn"),
    ],
)
def test_fractions_have_four_digits(override, shown):
    assert rounded(override) == shown


def test_a_pruned_job_is_no_failure(sweep, capsys):
    folder, jobs = sweep
    for job in jobs:
        (job / PRUNED).touch()
    show(sweep_table(folder, jobs))
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    found = [line[-1] for line in lines if line and line[0] in ("0", "1", "2", "3")]
    assert found == ["2.50", "-", "pruned", "pruned"]

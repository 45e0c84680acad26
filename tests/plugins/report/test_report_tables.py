"""Tables hold the numbers of the runs beside those of the paper, in its units, and say what is missing."""

from __future__ import annotations

import csv
import io
import math

import pytest
from runs import ORBIT, SEEDS, SPRING, paper_rows, reproduction, results, scores, write

from ahnn.errors import UserError
from ahnn.evaluation import Row, Who
from ahnn.types import Units
from ahnn_plugins.report.collection import collect
from ahnn_plugins.report.comparisons import ablation_table, agreement, order_table, ordered
from ahnn_plugins.report.figures.reading import kept
from ahnn_plugins.report.grid import Cell, Line
from ahnn_plugins.report.layout import grid_latex, latex, letter
from ahnn_plugins.report.markdown import grid_markdown
from ahnn_plugins.report.overviews import cost_table, ladder_table, score_table
from ahnn_plugins.report.paper_tables import energy_table, is_of_paper, rmse_table
from ahnn_plugins.report.plugin_numbers import consistency_table
from ahnn_plugins.report.remarks import remarks, unfinished
from ahnn_plugins.report.score_samples import Sample
from ahnn_plugins.report.scores import Measure, board
from ahnn_plugins.report.spreadsheet import COLUMNS, scores_csv


@pytest.fixture(scope="module")
def spring(tmp_path_factory):
    return collect([reproduction(tmp_path_factory.mktemp("runs") / "spring")])


@pytest.fixture(scope="module")
def orbit(tmp_path_factory):
    return collect([reproduction(tmp_path_factory.mktemp("runs") / "orbit", ORBIT)])


def line(grid, name):
    return next([cell.text for cell in each.cells] for each in grid.lines if each.name == name and each.cells)


def test_table_1_has_the_layout_and_the_units_of_the_paper(spring):
    grid = rmse_table(board(spring, "mass_spring"))
    assert [each.name for each in grid.lines if each.cells] == [
        *("MLP", "NODE", "HNN", "AHNN3", "AHNN5"),
        *("MLPKF", "NODEKF", "HNNKF", "AHNNKF3", "AHNNKF5"),
    ]
    assert [head.text for head in grid.heads[1]][1:3] == ["position [10⁻⁴ m]", "velocity [10⁻⁴ m/s]"]
    ours = line(grid, "AHNN5")
    assert ours[:3] == ["1.55 ± 0.031", "1.5528", "1.0×10⁻⁴"]
    assert ours[9:12] == ["14.6 ± 0.29", "14.586", "4.0"]
    assert all(sum(head.span for head in row) == grid.columns == 13 for row in grid.heads)
    bold = {each.name for each in grid.lines for cell in each.cells[:1] if cell.tone == "best"}
    assert bold == {"AHNN5", "AHNNKF5"}


def test_table_2_marks_suspicious_cells_with_a_reason(orbit):
    grid = rmse_table(board(orbit, "molniya"))
    assert line(grid, "NODE")[6:8] == ["14400 ± 290", "14374"]
    cell = next(each.cells[4] for each in grid.lines if each.name == "AHNN5")
    assert cell.text == "4.5962"
    assert "very likely ten times too large" in grid.notes[cell.note - 1]
    marked = {(e.name, i) for e in grid.lines for i, cell in enumerate(e.cells) if cell.note}
    assert len(marked) == 12
    assert line(energy_table(board(orbit, "molniya")), "HNN") == ["0.00643 ± 0.00013", "0.0064312", "0.0010"]


def test_the_order_of_models_says_which_of_its_steps_the_spread_decides(spring):
    samples = {"a": Sample((2.0, 2.1, 2.2)), "b": Sample((1.0, 1.1, 1.2)), "c": Sample((0.5, 1.0, 2.0))}
    assert str(ordered(samples, 0.95)) == "c ~ b < a"
    assert str(ordered({"a": Sample((math.nan, 1.0)), "b": Sample((1.0, 1.0))}, 0.95)) == "b ~ a"
    assert agreement(samples, {"a": 2.0, "b": 1.0, "c": 0.1, "d": 3.0}, 0.95) == (1, 0, 2)
    assert agreement(samples, {"a": 1.0, "b": 2.0}, 0.95) == (0, 1, 0)
    assert agreement(samples, {"A": 1.0, "B": 2.0}, 0.95) == (0, 1, 0)
    grid = order_table(board(spring, "mass_spring"), 0.95)
    order = "AHNN5 < HNN < AHNN3 < NODE < MLP"
    assert grid is not None
    assert line(grid, "position, true start") == [order, order, "10", "0", "0"]
    assert line(grid, "energy, perturbed start")[1:] == ["–"] * 4
    other = order_table(board(spring, "mass_spring")._replace(system="pendulum"), 0.95)
    assert other is not None
    assert other.columns == 2
    assert line(other, "position, true start") == [order]


def test_the_ablation_compares_windows_of_models_that_assume_the_same(spring):
    grid = ablation_table(board(spring, "mass_spring"), 0.95)
    assert grid is not None
    assert [each.name for each in grid.lines] == ["generic Hamiltonian", "W = 1", "W = 3", "W = 5"]
    assert line(grid, "W = 1")[:2] == ["3", "3.13×10⁻⁴ ± 6.3×10⁻⁶"]
    assert line(grid, "W = 5")[1].startswith("1.55×10⁻⁴ ± 3.1×10⁻⁶ (× 0.496 [0.474, 0.519])")


def test_costs_and_scores_are_those_of_the_runs(spring):
    scores_of = board(spring, "mass_spring")
    assert line(cost_table(scores_of), "AHNN5")[:5] == ["3", "10", "100", "4417", "5"]
    grid = score_table(scores_of)
    assert line(grid, "UKF, perturbed start")[:3] == ["3", "0.00156 ± 0.000031", "2.00×10⁻⁴"]


def test_prior_knowledge_loss_and_noise_make_rows_of_their_own(tmp_path):
    rows = [Row(Who("model", "true"), scores(1.0))]
    for name, assumes, config in (
        ("a", "generic", "data: {noise: null}\nloss: {derivative: 0.0}\n"),
        ("b", "mechanical", "data: {noise: [0.1, 0.2]}\nloss: {stages: [[weak, 0.5]]}\n"),
        ("c", "mechanical", "data: {noise: null}\nloss: {derivative: 1.0}\n"),
        ("d", "mechanical", "a: &x 1\nb: *x\n"),
    ):
        folder = write(tmp_path / name, results(rows, name)._replace(assumes=assumes))
        (folder / "config.yaml").write_text(config)
    grid = ladder_table(board(collect([tmp_path]), "mass_spring"))
    assert grid is not None
    found = [(each.name, *(cell.text for cell in each.cells[:3])) for each in grid.lines]
    assert found == [
        ("generic", "recursive", "exact", "a"),
        ("mechanical", "weak form", "[0.1, 0.2]", "b"),
        ("mechanical", "derivatives", "exact", "c"),
        ("mechanical", "–", "–", "d"),
    ]


def test_all_scores_are_a_csv_table_with_all_digits(orbit):
    rows = list(csv.DictReader(io.StringIO(scores_csv(orbit))))
    assert list(rows[0]) == list(COLUMNS)
    assert len(rows) == 5 * 4 * 3
    want = {"model": "AHNN5", "estimator": "ukf", "start": "perturbed", "quantity": "position"}
    (row,) = [row for row in rows if want.items() <= row.items()]
    assert (float(row["mean"]), float(row["paper"]), row["runs"]) == (pytest.approx(50.38), 50.38, "3")
    assert float(row["standard_deviation"]) == pytest.approx(0.02 * 50.38)
    assert row["unit"] == "km"


def test_a_run_of_another_recipe_is_no_row_of_the_paper(tmp_path):
    """`ahnn5` is the label of the plain command, whose recipe is not the paper's."""
    write(tmp_path / "paper", results(paper_rows("mass_spring", "AHNN5", 1.0), "AHNN5", 7))
    write(tmp_path / "own", results(paper_rows("mass_spring", "AHNN5", 0.01), "ahnn5", 201))
    groups = board(collect([tmp_path]), "mass_spring").groups
    assert {model: len(entries) for model, entries in groups.items()} == {"AHNN5": 1, "ahnn5": 1}


def test_missing_models_filters_seeds_and_unequal_runs_are_said(tmp_path):
    reproduction(tmp_path / "a", models=("HNN", "AHNN3"), filtered=False)
    rows = paper_rows("mass_spring", "MLP", 1.0)
    changed = results(rows, "MLP", 7)
    write(tmp_path / "b", changed._replace(training=changed.training | {"steps": 5}, assumes="more"))
    write(tmp_path / "c", results(rows, "MLP", 7))
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "config.yaml").write_text("")
    found = collect([tmp_path])
    said = "\n".join(remarks(board(found, "mass_spring")))
    for part in (
        "No runs of NODE, AHNN5: their cells are empty.",
        "unequal numbers of runs: MLP 2, HNN 3, AHNN3 3",
        "MLP: seed 7 occurs more than once",
        "8 of 8 runs kept no predictions",
        "6 of 8 runs were not evaluated with a filter",
        "Runs of MLP differ in assumptions: more, nothing.",
        "Runs of MLP differ in optimiser steps: 5, 100.",
        "unequal numbers of optimiser steps",
    ):
        assert part in said
    assert unfinished(found.unfinished) == [
        f"1 runs have no results, and are not in this report: {tmp_path / 'd'}."
    ]
    alone = collect([tmp_path / "a" / "HNN_7"])
    assert any("with a filter (plugins=ukf, for simul" in one for one in remarks(board(alone, "mass_spring")))
    (tmp_path / "a" / "HNN_7" / "evaluations").mkdir()
    (later,) = [one for one in remarks(board(alone, "mass_spring")) if "with a filter" in one]
    assert later.endswith("Evaluations after the training (evaluations/) are not part of the report.")
    grid = rmse_table(board(found, "mass_spring"))
    assert line(grid, "NODE")[:2] == ["–", "6.3214"]
    assert line(grid, "HNNKF")[:2] == ["–", "0.7261"]


def test_other_trajectories_and_lost_predictions_are_said(tmp_path):
    for name, floor, value in (("a", 1.0, 2.0), ("b", 1.1, math.inf)):
        rows = [Row(Who("model", "true"), scores(value))]
        rows.append(Row(Who("exact", "true", floor=True), scores(floor)))
        write(tmp_path / name, results(rows, seed=SEEDS[name == "a"]))
    said = "\n".join(remarks(board(collect([tmp_path]), "mass_spring")))
    assert "not judged on the same trajectories" in said
    assert "HNN: 1 of 2 scores are not finite" in said


def test_a_system_of_other_units_or_another_name_has_no_numbers_of_the_paper(tmp_path):
    rows = [Row(Who("model", "true"), scores(1.0, energy=None))]
    write(tmp_path / "a" / "x", results(rows, space=SPRING._replace(units=ORBIT.units)))
    found = board(collect([tmp_path / "a"]), "mass_spring")
    assert not is_of_paper(found)
    assert any("units differ from those of the paper" in text for text in remarks(found))
    write(tmp_path / "b" / "x", results(rows, space=SPRING._replace(name="pendulum")))
    other = board(collect([tmp_path / "b"]), "pendulum")
    assert not is_of_paper(other)
    assert other.printed(Measure("HNN")) is None
    assert line(score_table(other), "no measurements, true start") == ["1", "1.00", "–", "2.00", "–"]


def test_what_was_not_measured_has_no_column_and_what_is_lost_is_said(tmp_path):
    for seed in SEEDS:  # positions alone
        rows = [Row(Who("model", "true"), scores(1.0, math.nan, math.inf))]
        rows.append(Row(Who("exact", "true", floor=True), scores(0.5, math.nan)))
        write(tmp_path / str(seed), results(rows, seed=seed))
    found = score_table(board(collect([tmp_path]), "mass_spring"))
    cells = line(found, "no measurements, true start")
    assert cells[1:] == ["1.00 ± 0", "0.500", "lost in 3 of 3", "0.00100"]
    assert [head.text for head in found.heads[0][2:]] == ["position [m]", "energy [J]"]


def test_a_tuned_filter_stands_in_the_rows_of_the_paper_beside_the_floor_of_the_plain_one(tmp_path):
    rows = [Row(Who("model", "true", name), scores(v)) for name, v in (("ukf", 2.0), ("ukf_tuned", 1.0))]
    rows.append(Row(Who("exact", "true", "ukf", floor=True), scores(0.5)))
    write(tmp_path / "a", results(rows))
    found = board(collect([tmp_path]), "mass_spring")
    measure = Measure("HNN", filtered=True)
    assert (found.estimator, found.sample(measure).values, found.floor(measure).values) == (
        "ukf_tuned",
        (1.0,),
        (0.5,),
    )


def test_later_evaluations_count_once_and_links_do_not_double_a_run(tmp_path):
    rows = [Row(Who("model", "true"), scores(1.0))]
    run = write(tmp_path / "runs" / "a", results(rows))
    write(run / "evaluations" / "later", results(rows))
    write(tmp_path / "runs" / "pretrained" / "evaluations" / "one", results(rows, seed=8))
    (tmp_path / "link").symlink_to(run)
    found = collect([tmp_path / "runs", tmp_path / "link"])
    assert [entry.seed for entry in found.entries] == [7, 8]
    assert not found.unfinished
    assert collect([run / "evaluations" / "later"]).entries[0].seed == 7
    with pytest.raises(UserError, match="expected a run, or a folder of runs"):
        collect([tmp_path / "nowhere"])
    (run / "predictions.safetensors").write_bytes(b"x" * 20)
    with pytest.raises(UserError, match="Evaluate the run again"):
        kept(found.entries[0], 0)


def test_consistency_is_judged_by_the_band_of_what_plugins_say():
    numbers = {
        "f": {"true": {"nees": {"mean": 9.0, "band_95": [1.0, 2.0]}}, "x": {"mean": 1, "band_95": [1, 2]}}
    }
    numbers["g"] = {"nis": {"mean": 0.5, "band_95": [1.0, 2.0]}, "odd": {"mean": "a", "band_95": [0, 1]}}
    grid = consistency_table("s", numbers)
    assert grid is not None
    assert {each.name: each.cells[2].text for each in grid.lines} == {
        "f / true / nees": "overconfident",
        "f / x": "consistent",
        "g / nis": "too cautious",
    }
    assert consistency_table("s", {"a": 1}) is None


def test_latex_has_the_columns_that_it_declares_and_no_sign_of_its_own_from_outside(orbit):
    text = grid_latex(rmse_table(board(orbit, "molniya")))
    rows = [part for part in text.splitlines() if part.endswith(r"\\") and "multicolumn" not in part]
    assert all(part.count("&") == 12 for part in rows)
    assert r"\begin{tabular}{l" + 12 * "r" + "}" in text
    assert r"4.5962\textsuperscript{b}" in text
    assert latex(r"\input{x} 50% a_b 10⁻⁴") == r"\textbackslash{}input\{x\} 50\% a\_b 10$^{-4}$"
    assert [letter(n) for n in (1, 26, 27, 52, 53)] == ["a", "z", "aa", "az", "ba"]


def test_markdown_has_a_cell_in_each_column_and_no_sign_of_its_own_from_outside(orbit):
    grid = rmse_table(board(orbit, "molniya"))
    told, _, *rows = grid_markdown(grid).splitlines()
    table = [row for row in rows if row.startswith("|")]
    assert len(table) == 2 + len(grid.lines)
    assert {row.count("|") for row in table} == {grid.columns + 1}
    assert table[1] == "| --- |" + " --: |" * 12
    assert "4.5962<sup>b</sup>" in "".join(table)
    assert any(row.startswith("b: ") for row in rows)
    evil = grid._replace(title="a|b <b>*c*", lines=(Line("x|y"), Line("z", (Cell("`1|2`"),) * 12)))
    told, _, *_, group, line = grid_markdown(evil._replace(notes=())).splitlines()
    assert told.startswith(r"**a\|b &lt;b&gt;\*c\*** ")
    assert group == r"| x\|y |" + "  |" * 12
    assert line == "| z |" + r" \`1\|2\` |" * 12


def test_runs_on_other_files_or_in_other_units_are_never_pooled(tmp_path):
    """Seeds of one file share a row; a file of this name elsewhere, or in metres, has a row of its own."""
    kilometres = ORBIT._replace(name="files")
    metres = kilometres._replace(units=Units("s", "m", "m/s", "m²/s²"))
    runs = [("a", 7, kilometres, "one/gto.csv", 1.0), ("b", 8, kilometres, "one/gto.csv", 3.0)]
    runs += [("c", 7, metres, "one/gto.csv", 5e3), ("d", 7, kilometres, "two/gto.csv", 40.0)]
    for name, seed, space, path, error in runs:
        rows = [Row(Who("model", "fitted"), scores(error, energy=None))]
        folder = write(tmp_path / name, results(rows, seed=seed, space=space))
        (folder / "config.yaml").write_text(f"system: {{name: files, path: {path}}}\n")
    found = collect([tmp_path])
    table = [row for row in csv.DictReader(io.StringIO(scores_csv(found))) if row["quantity"] == "position"]
    assert {(r["system"], r["unit"], r["runs"], float(r["mean"])) for r in table} == {
        ("files (one/gto.csv) [km, s]", "km", "2", 2.0),
        ("files (one/gto.csv) [m, s]", "m", "1", 5e3),
        ("files (two/gto.csv)", "km", "1", 40.0),
    }
    assert collect([tmp_path / "a", tmp_path / "b"]).systems() == ["files"]
    assert collect([tmp_path / "a", tmp_path / "c"]).systems() == ["files [km, s]", "files [m, s]"]

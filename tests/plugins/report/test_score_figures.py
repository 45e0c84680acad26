"""Figures of scores: a dot for each seed and their mean, beside the floor and the values of the paper."""

from __future__ import annotations

import math

import pytest
from safetensors.torch import load_file, save_file
from synthetic_runs import SPRING, results, run, write

from ahnn.evaluation import Row, Who
from ahnn.metrics import Scores
from ahnn_plugins.report.collection import collect
from ahnn_plugins.report.drawing import Drawing
from ahnn_plugins.report.figures import draw
from ahnn_plugins.report.figures.scores import BESIDE, SEEDS
from ahnn_plugins.report.interactive import to_html
from ahnn_plugins.report.markup import Markup
from ahnn_plugins.report.paper import printed_value
from ahnn_plugins.report.pictures import Picture, of_system
from ahnn_plugins.report.static import to_matplotlib


def drawn(*folders) -> dict[str, Drawing]:
    return {drawing.name: drawing for drawing in draw(collect(folders))}


def test_scores_stand_beside_the_floor_and_the_paper(springs):
    panel = drawn(springs)["mass_spring_rmse_true"].panels[0]
    assert panel.ticks == ("MLP", "AHNN3", "AHNN5")
    ours, seeds = (s for s in panel.series if s.label == "AHNN5")
    values = [1e-4 * (1 + seed / 1000) for seed in (7, 201)]
    assert (ours.role, seeds.role) == ("model", "seed")
    assert ours.y.tolist() == pytest.approx([sum(values) / 2], rel=1e-12)
    assert sorted(seeds.y.tolist()) == pytest.approx(values)
    assert "arithmetic mean, as in the tables" in drawn(springs)["mass_spring_rmse_true"].spread
    assert "tables give mean ± standard deviation" in drawn(springs)["mass_spring_rmse_true"].caption
    (paper,) = [s for s in panel.series if s.role == "paper"]
    assert any(value == pytest.approx(9.173e-3) for value in paper.y.tolist())
    windows = drawn(springs)["mass_spring_windows"].panels[0]
    assert windows.ticks == ("W = 3", "W = 5")


def test_a_figure_of_scores_from_fitted_starts_says_that_they_include_the_noise(tmp_path):
    told = results(SPRING.space, "mine", 7)
    rows = tuple(row._replace(who=row.who._replace(start="fitted")) for row in told.rows[:1])
    write(tmp_path / "run", told._replace(rows=rows), None, None)
    caption = drawn(tmp_path)["mass_spring_rmse_fitted"].caption
    assert "differences from the measurements and include their noise." in caption


def test_a_model_of_several_windows_has_a_dot_at_each(tmp_path):
    for window in (1, 4):
        told = results(SPRING.space, "mine", 7)
        told = told._replace(training=told.training | {"window": window})
        write(tmp_path / str(window), told, None, None)
    panel = drawn(tmp_path)["mass_spring_windows"].panels[0]
    assert panel.ticks == ("W = 1", "W = 4")
    (dots,) = [series for series in panel.series if series.role == "model"]
    assert [round(place) for place in dots.x.tolist()] == [0, 1]


def test_printed_numbers():
    assert printed_value("molniya", "ahnn5", "perturbed", "position", ukf=True) == 50.38
    assert printed_value("mass_spring", "NODE", "true", "energy") == 5.2546e-4
    assert printed_value("pendulum", "NODE", "true", "position") is None


def test_runs_without_arrays_have_scores_alone(tmp_path):
    write(tmp_path / "a", results(SPRING.space, "HNN", 7), None, None)
    assert set(drawn(tmp_path)) == {"mass_spring_rmse_true", "mass_spring_rmse_perturbed"}


def test_later_evaluations_of_a_run_are_no_seeds(tmp_path):
    folder = run(tmp_path, SPRING, "AHNN5")
    run(folder / "evaluations", SPRING, "AHNN5", 8)
    (panel, *_) = drawn(tmp_path)["mass_spring_rmse_true"].panels
    assert all(series.role != "seed" for series in panel.series)


def scored(folder, seed, *rows):
    """A run with position scores alone, the model's first, without or with its floor."""
    cells = [
        Row(who, Scores(value, math.nan, value, math.nan, None, (value, math.nan))) for who, value in rows
    ]
    told = results(SPRING.space, "mine", seed)
    write(folder, told._replace(rows=tuple(cells)), None, None)


def test_dots_are_centred_on_their_label_and_a_far_floor_is_stated(tmp_path):
    """Seeds that differ twofold would be a blob on an axis that reaches down to 1e-6."""
    for seed, value in ((7, 0.1), (8, 0.2), (9, 0.15)):
        rows = (Who("model", "true"), value), (Who("exact", "true", floor=True), 1e-6)
        scored(tmp_path / f"run{seed}", seed, *rows)
    (panel,) = drawn(tmp_path)["mass_spring_rmse_true"].panels
    mean, seeds = panel.series
    assert mean.x.tolist() == [0.0]
    assert mean.y.tolist() == pytest.approx([0.15])  # the geometric mean is 0.144
    assert sorted(seeds.x.tolist()) == [-SEEDS, -SEEDS, SEEDS]
    assert panel.note == "floor: 1e-06, below the axis"
    assert "with the filter" not in drawn(tmp_path)["mass_spring_rmse_true"].caption
    shown = to_matplotlib(drawn(tmp_path)["mass_spring_rmse_true"]).axes[0]
    assert shown.get_ylim()[0] > 0.05
    assert shown.get_title("right") == panel.note
    assert "floor: 1e-06" in to_html(drawn(tmp_path)["mass_spring_rmse_true"])


def test_a_near_floor_is_drawn_and_a_filter_stands_beside(tmp_path):
    rows = (
        (Who("model", "true"), 0.1),
        (Who("exact", "true", floor=True), 2e-3),
        (Who("model", "true", "ukf"), 0.05),
    )
    scored(tmp_path / "run", 7, *rows)
    (panel,) = drawn(tmp_path)["mass_spring_rmse_true"].panels
    places = {series.role: series.x.tolist() for series in panel.series}
    assert places == {"model": [-BESIDE], "filter": [BESIDE], "floor": [-BESIDE]}
    assert panel.note == ""


def test_velocities_without_measurements_have_no_panel(tmp_path):
    folder = run(tmp_path, SPRING, "AHNN5")
    names = ("mass_spring_averages_true", "mass_spring_error_true")
    assert [len(drawn(folder)[name].panels) for name in names] == [2, 2]
    path = folder / "predictions.safetensors"
    arrays = load_file(path)
    arrays = {name: unmeasured(array) if array.shape[-1] == 2 else array for name, array in arrays.items()}
    save_file(arrays, path)
    assert [len(drawn(folder)[name].panels) for name in names] == [1, 1]


def unmeasured(states):
    states = states.clone()
    states[..., 1] = math.nan
    return states


def test_figures_are_placed_by_the_portable_name_of_their_system():
    drawing = Drawing("files_gto_csv_rmse_true", "", "", ())
    picture = Picture(drawing, Markup(), {})
    assert of_system([picture], ["files (gto.csv)", "files"]) == {"files (gto.csv)": [picture]}

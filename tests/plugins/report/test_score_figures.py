"""Figures of scores: a dot for each seed and their mean, beside the floor and the values of the paper."""

from __future__ import annotations

import math

import pytest
from synthetic_runs import SPRING, results, run, write

from ahnn_plugins.report.collection import collect
from ahnn_plugins.report.drawing import Drawing
from ahnn_plugins.report.figures import draw
from ahnn_plugins.report.paper import printed_value


def drawn(*folders) -> dict[str, Drawing]:
    return {drawing.name: drawing for drawing in draw(collect(folders))}


def test_scores_stand_beside_the_floor_and_the_paper(springs):
    panel = drawn(springs)["mass_spring_rmse_true"].panels[0]
    assert panel.ticks == ("MLP", "AHNN3", "AHNN5")
    ours, seeds = (s for s in panel.series if s.label == "AHNN5")
    values = [1e-4 * (1 + seed / 1000) for seed in (7, 201)]
    assert (ours.role, seeds.role) == ("model", "seed")
    assert ours.y.tolist() == pytest.approx([math.sqrt(values[0] * values[1])])
    assert sorted(seeds.y.tolist()) == pytest.approx(values)
    assert "geometric mean" in drawn(springs)["mass_spring_rmse_true"].spread
    assert "tables give mean ± standard deviation" in drawn(springs)["mass_spring_rmse_true"].caption
    (paper,) = [s for s in panel.series if s.role == "paper"]
    assert any(value == pytest.approx(9.173e-3) for value in paper.y.tolist())
    windows = drawn(springs)["mass_spring_windows"].panels[0]
    assert windows.ticks == ("W = 3", "W = 5")


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

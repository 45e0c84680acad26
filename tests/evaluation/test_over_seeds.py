"""Mean and spread over seeds, on numbers whose mean and deviation are known."""

from __future__ import annotations

import math

import pytest

from ahnn.evaluation.case import Row, Who
from ahnn.evaluation.results import Results
from ahnn.evaluation.seed_summary import cell, scores, seeds_table
from ahnn.metrics import Scores
from ahnn.types import Space, Units

UNITS = Units(time="s", position="m", velocity="m/s", energy="J")


def row(value, process="model", start="true", estimator=None, span="whole", floor=False):
    numbers = Scores(value, 10 * value, value, value, None, ())
    return Row(Who(process, start, estimator, span, floor), numbers)


def run(label, value):
    rows = (
        row(value),
        row(99.0, span="settled", estimator="ukf"),
        row(0.25, process="exact field, rk4", floor=True),
        row(2 * value, start="perturbed", estimator="ukf"),
    )
    return Results(label, "", Space("spring", ("q", "p"), UNITS, 1.0), rows)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ([], "-"),
        ([0.5], "0.500"),
        ([1.0, 2.0, 3.0], "2.00 ±50%"),
        ([2e-4, 2e-4], "2.00e-04 ±0%"),
        ([1.0, math.inf], "inf"),
    ],
)
def test_a_cell_has_mean_and_relative_spread(values, text):
    assert cell(values) == text


def test_a_score_is_of_one_estimator_start_and_the_whole_span():
    runs = [run("HNN", 1.0), run("HNN", 3.0)]
    assert scores(runs, None, "true", "position") == [1.0, 3.0]
    assert scores(runs, None, "true", "position", floor=True) == [0.25, 0.25]
    assert scores(runs, "ukf", "perturbed", "velocity") == [20.0, 60.0]
    assert scores(runs, "ukf", "true", "position") == []


def test_the_table_has_a_line_a_model_below_each_estimator():
    lines = list(seeds_table([run("HNN", 1.0), run("HNN", 3.0), run("AHNN5", 4.0)]))
    assert max(map(len, lines)) <= 80
    words = [line.split() for line in lines]
    assert ["HNN", "2.00", "±71%", "20.0", "±71%", "-", "-"] in words
    assert ["AHNN5", "-", "-", "8.00", "80.0"] in words
    assert ["floor", "0.250", "2.50", "-", "-"] in words

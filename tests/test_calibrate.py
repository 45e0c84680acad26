"""The command that trains on draws of truth and data: what it draws, keeps and refuses, and its tests."""

from __future__ import annotations

import json
import math
import random

import pytest
from entry import call
from scipy.stats import norm

from ahnn.cli.calibrating import constants_of
from ahnn.evaluation.rank_test import rank_table, ranks, uniformity


def scores(count, width=1.0):
    """Numbers of trainings whose errors are this many times as large as their bands."""
    drawn = random.Random(0)

    def off(rows):
        return [[drawn.gauss(0, width) for _ in range(2)] for _ in range(rows)]

    test = {"directions": 10, "scatter": width}
    return [
        {
            "uncertainty": {"single": off(3), "coverage": [0.6, 0.9, 1.0], "test": test},
            "forecast": {"single": off(1)[0], "states": [0.7, 0.95, 1.0]},
        }
        for _ in range(count)
    ]


def test_ranks_are_the_normal_distribution_of_errors_one_for_each_draw():
    found = ranks(made := scores(5))
    assert list(found) == [f"{name}, {i}" for name in ("state at a quarter", *OTHERS) for i in (1, 2)]
    expected = sorted(norm.cdf([one["forecast"]["single"][1] for one in made]))
    assert found["forecast, 2"] == pytest.approx(expected)


OTHERS = ("state at half", "state at the end", "forecast")


def test_what_is_absent_has_no_rank():
    made = scores(3)
    made[0]["uncertainty"]["single"][0][0] = math.nan
    made[1]["forecast"]["single"] = None
    found = ranks(made)
    assert len(found["state at a quarter, 1"]) == len(found["forecast, 1"]) == 2


@pytest.mark.parametrize(
    ("width", "verdict", "bands"), [(1, "uniform", "right"), (3, "not uniform", "narrow")]
)
def test_bands_that_are_too_narrow_are_refused_and_right_ones_are_not(width, verdict, bands):
    text = rank_table(scores(60, width))
    assert f"ranks: {verdict}, least p" in text
    assert "states, all trajectories: 60.0, 90.0, 100.0 % within 1, 2, 3 sigma, mean of 60 draws" in text
    assert f"errors along 600 independent directions are {width}.00" in text
    assert text.endswith(bands)
    assert "ranks: too few draws to tell" in rank_table(scores(3))


def test_uniformity_of_one_rank_is_exact():
    """One rank u is as far from uniform as max(u, 1 - u), which exceeds d with probability 2 (1 - d)."""
    assert uniformity([0.9]) == pytest.approx(2 * (1 - 0.9))


def test_a_draw_has_constants_of_its_own_the_same_each_time():
    words = ["experiment=spring_noisy"]
    (first,), (again,), (other,) = (constants_of(words, 0.1, number) for number in (1, 1, 2))
    assert first == again != other
    name, _, value = first.partition("=")
    assert name == "system.stiffness"
    assert 0 < abs(math.log(float(value) / 5.0)) < 0.5
    assert constants_of(words, 0.0, 1) == []


def test_what_is_finished_is_kept_shown_and_drawn(tmp_path, capfd, caplog):
    caplog.set_level("INFO", "ahnn")
    for number, one in enumerate(scores(3), 1):
        (tmp_path / f"draw_{number}").mkdir()
        (tmp_path / f"draw_{number}" / "score.json").write_text(json.dumps(one))
    assert call("ahnn.calibrate", "experiment=spring_noisy", "draws=3", f"output={tmp_path}") == 0
    assert f"3 draws in {tmp_path}, 3 finished" in caplog.text
    assert "mean of 3 draws" in capfd.readouterr().out
    assert (tmp_path / "calibration.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["experiment=spring"], "calibrate: expected simulated measurements of a system"),
        (["experiment=spring_noisy", "draws=0"], "draws"),
        (["experiment=spring_noisy", "spread=2"], "spread"),
        (["experiment=nothing"], "experiment"),
        (["experiment=spring_noisy", "run=mine"], "run: expected no value, since each draw has its own"),
        (["experiment=spring_noisy", "data.seed=3"], "data.seed: expected no value"),
    ],
)
def test_mistakes_are_one_message_before_any_work(words, message, capfd, tmp_path):
    assert call("ahnn.calibrate", *words, f"output={tmp_path / 'out'}") == 2
    error = capfd.readouterr().err
    assert message in error
    assert not (tmp_path / "out").exists()

"""The command that trains on draws of truth and data: what it draws, keeps and refuses, and its tests."""

from __future__ import annotations

import json
import math
import random

import pytest
from entry import call
from scipy.stats import norm

from ahnn.cli import calibrating
from ahnn.cli.calibrating import CalibrationDraw, CalibrationRequest, constants_of
from ahnn.cli.numbered_draws import run_missing
from ahnn.errors import TrainingError
from ahnn.evaluation.rank_test import rank_table, ranks, share_line, uniformity


def scores(count, width=1.0):
    """Numbers of trainings whose errors are this many times as large as their bands."""
    drawn = random.Random(0)

    def off(rows):
        return [[drawn.gauss(0, width) for _ in range(2)] for _ in range(rows)]

    test = {"directions": 10, "scatter": width}
    parts = [[0.5, k / 3, 1.0] for k in range(3)]
    return [
        {
            "uncertainty": {"single": off(3), "coverage": [0.6, 0.9, 1.0], "test": test},
            "forecast": {"single": off(3), "states": [0.7, 0.95, 1.0], "parts": parts},
        }
        for _ in range(count)
    ]


def test_ranks_are_the_normal_distribution_of_errors_one_for_each_draw():
    found = ranks(made := scores(5))
    states = [f"state at {when}" for when in ("a quarter", "half", "the end")]
    forecasts = [f"forecast at {when}" for when in ("a fifth", "two fifths", "the end")]
    assert list(found) == [f"{name}, {i}" for name in (*states, *forecasts) for i in (1, 2)]
    expected = sorted(norm.cdf([one["forecast"]["single"][1][1] for one in made]))
    assert found["forecast at two fifths, 2"] == pytest.approx(expected)


def test_what_is_absent_has_no_rank():
    made = scores(3)
    made[0]["uncertainty"]["single"][0][0] = math.nan
    made[1]["forecast"]["single"] = None
    found = ranks(made)
    assert len(found["state at a quarter, 1"]) == len(found["forecast at a fifth, 1"]) == 2


@pytest.mark.parametrize(
    ("width", "verdict", "bands"), [(1, "uniform", "right"), (3, "not uniform", "narrow")]
)
def test_bands_that_are_too_narrow_are_refused_and_right_ones_are_not(width, verdict, bands):
    text = rank_table(scores(60, width))
    assert f"ranks: {verdict}, smallest p" in text
    assert "within 1, 2 and 3 sigma, all trajectories, mean over 60 draws:" in text
    assert "states                    60.0, 90.0, 100.0 %, standard error 0.0 % within 2 sigma" in text
    assert "forecasts at two fifths   50.0, 33.3, 100.0 %" in text
    assert f"errors along 600 independent directions are {width}.00" in text
    assert text.endswith(bands)
    assert "ranks: too few draws to tell" in rank_table(scores(3))


def test_coverage_where_errors_propagate_linearly_is_told_apart_if_some_do_not():
    made, rows = scores(4), [[0.6, 0.9, 1.0], [0.3, 0.6, 0.7], None]
    for one in made:
        linear = {"states": [0.7, 0.95, 1.0], "parts": [rows[0]] * 3}
        one["forecast"] |= {"nonlinear": 0.0, "linear": linear}
    assert "propagate linearly" not in rank_table(made)
    made[0]["forecast"] |= {"nonlinear": 0.5}
    made[1]["forecast"] |= {"nonlinear": 1.0, "linear": {"states": None, "parts": [None] * 3}}
    made[2]["forecast"]["linear"] = {"states": [0.4, 0.8, 0.7], "parts": rows}
    text = rank_table(made)
    assert "where errors propagate linearly (62 % of the forecast states):" in text
    error = "%, standard error {} % within 2 sigma, {} draws"
    assert f"forecasts                 60.0, 90.0, 90.0 {error.format('5.0', 3)}" in text
    assert f"forecasts at two fifths   50.0, 80.0, 90.0 {error.format('10.0', 3)}" in text
    assert f"forecasts at the end      60.0, 90.0, 100.0 {error.format('0.0', 2)}" in text


def test_coverage_with_sampled_paths_is_told_where_some_errors_do_not_propagate_linearly():
    made = scores(2)
    for one in made:
        linear = {"states": [0.7, 0.95, 1.0], "parts": [[0.6, 0.9, 1.0]] * 3}
        sampled = {"states": [0.5, 0.8, 0.9], "parts": [[0.4, 0.7, 0.8]] * 3}
        one["forecast"] |= {"nonlinear": 0.25, "linear": linear, "sampled": sampled}
    _, _, text = rank_table(made).partition("with sampled paths where they do not:")
    assert "forecasts                 50.0, 80.0, 90.0 %, standard error 0.0 % within 2 sigma" in text
    assert "forecasts at the end      40.0, 70.0, 80.0 %, standard error 0.0 % within 2 sigma" in text
    del made[0]["forecast"]["sampled"], made[1]["forecast"]["sampled"]
    assert "sampled" not in rank_table(made)


def test_draws_whose_training_ended_early_are_also_left_out():
    made = scores(20)
    assert "without them" not in rank_table(made)
    for one in made[:3]:
        one["uncertainty"] |= {"remaining": 5.0, "determined": 4.0, "coverage": [0.0, 0.5, 1.0]}
    made[3]["uncertainty"] |= {"remaining": 3.0, "determined": 4.0}
    every, _, rest = rank_table(made).partition(
        "3 of 20 training runs warn that they ended before their optimum"
    )
    assert "states                    51.0, 84.0, 100.0 %" in every
    assert "states                    60.0, 90.0, 100.0 %" in rest
    assert "bands of states, 17 draws: errors along 170 independent directions" in rest


def test_a_mean_of_fractions_has_the_standard_error_of_independent_draws():
    """Of 0.9 and 1.0: mean 0.95, deviation 0.0707, divided by the root of two."""
    found = share_line([[0.6, 0.9, 1.0], [0.8, 1.0, 1.0]])
    assert found == "70.0, 95.0, 100.0 %, standard error 5.0 % within 2 sigma"


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


def test_a_system_that_lists_no_constants_draws_its_gravity_or_its_mass():
    for system, name in (("three_body", "gravity"), ("double_pendulum", "gravity"), ("henon_heiles", "mass")):
        (found,) = constants_of([f"system={system}", "sensor=spring_states"], 0.1, 1)
        assert found.startswith(f"system.{name}=")


def test_draws_of_a_process_fail_alone(tmp_path, monkeypatch, caplog):
    caplog.set_level("INFO", "ahnn")
    done = []

    def one(draw, *_):
        if draw.number == 2:
            raise TrainingError("diverged")
        done.append(draw.number)

    monkeypatch.setattr(calibrating, "one", one)
    plan = [CalibrationDraw(number, tmp_path) for number in (1, 2, 3)]
    with pytest.raises(TrainingError, match="1 of 3 draws failed"):
        calibrating.several(plan, [], CalibrationRequest())
    assert done == [1, 3]
    assert "draw 2: diverged" in caplog.text


def test_processes_share_the_draws_and_what_they_report_is_shown(tmp_path, monkeypatch, caplog):
    caplog.set_level("INFO", "ahnn")
    plan = [CalibrationDraw(number, tmp_path / f"draw_{number}") for number in range(1, 6)]
    plan[0].folder.mkdir()
    (plan[0].folder / "score.json").write_text("{}")
    (tmp_path / "worker.py").write_text(WORKER)
    shares = []

    def words(share):
        shares.append([draw.number for draw in share])
        return ["worker", *(str(draw.folder) for draw in share)]

    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    failed = run_missing(plan, words, 2, shared=True)
    assert sorted(shares) == [[2, 4], [3, 5]]
    assert [draw.number for draw in failed] == [5]
    assert "draw_4 done" in caplog.text
    assert "the last words" in caplog.text


WORKER = """
import pathlib, sys
for folder in map(pathlib.Path, sys.argv[1:]):
    if folder.name == "draw_5":
        sys.exit("the last words")
    folder.mkdir()
    (folder / "score.json").write_text("{}")
    print(f"draw {folder.name} done", file=sys.stderr)
"""


def test_what_is_finished_is_kept_shown_and_drawn(tmp_path, capfd, caplog):
    caplog.set_level("INFO", "ahnn")
    for number, one in enumerate(scores(3), 1):
        (tmp_path / f"draw_{number}").mkdir()
        settings = {"training": ["experiment=spring_noisy"], "spread": 0.1, "fitted": 0.5, "samples": 0}
        (tmp_path / f"draw_{number}" / "score.json").write_text(json.dumps(one | {"settings": settings}))
    assert call("ahnn.calibrate", "experiment=spring_noisy", "draws=3", f"output={tmp_path}") == 0
    assert f"3 draws in {tmp_path}, 3 of them finished" in caplog.text
    assert "mean over 3 draws" in capfd.readouterr().out
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


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["data.noise=0.05"], "training.data.noise: expected nothing, received 0.05\nChoose"),
        (["spread=0.3"], "spread: expected 0.1, received 0.3\nChoose another folder than output="),
        (["samples=10"], "samples: expected "),
    ],
)
def test_draws_of_other_settings_are_refused(words, message, capfd, tmp_path):
    settings = {"training": ["experiment=spring_noisy"], "spread": 0.1, "fitted": 0.5, "samples": 0}
    (tmp_path / "draw_1").mkdir()
    (tmp_path / "draw_1" / "score.json").write_text(json.dumps(scores(1)[0] | {"settings": settings}))
    command = ["ahnn.calibrate", "experiment=spring_noisy", *words, "draws=1", f"output={tmp_path}"]
    assert call(*command) == 2
    assert message in capfd.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["draw_1"]

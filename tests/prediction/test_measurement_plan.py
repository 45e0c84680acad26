"""Plans of measurements: greedy choices against least squares by hand, and `python -m ahnn.plan`."""

from __future__ import annotations

import csv
import itertools
import math

import numpy as np
import pytest
import torch
from entry import call
from helpers import close
from test_predict import small

from ahnn.jobs.planning import aligned, lines_of
from ahnn.prediction.measurement_plan import evenly_spaced, plan_measurements, variance_with
from ahnn.prediction.propagation import prediction_factors

MOLNIYA = ("pretrained=molniya_mechanical", "start=[0,-3145,-6173,10,0,0]", "start_sd=[1,0.001]")
ASKED = (*MOLNIYA, "duration=1d", "every=2h", "at=2d")
STATIONS = """
hawaii: {latitude: 19.0, longitude: -155.7, min_elevation: 10, noise: {range: 0.01, azimuth: 0.006}}
biased: {latitude: 19.0, longitude: -155.7, min_elevation: 10, noise: {range: 0.01}, bias_sd: {range: 50.0}}
"""


def drawn(seed, candidates=7, unknowns=4):
    generator = torch.Generator().manual_seed(seed)
    normal = [
        torch.randn(k % 3 + 1, unknowns, generator=generator, dtype=torch.float64) for k in range(candidates)
    ]
    return normal, torch.randn(2, unknowns, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize("sd", [1.0, 1e9])
def test_what_is_hardly_known_before_is_known_as_well_as_it_is_measured(sd):
    """K measurements of one unknown with deviations of one: a variance of sd^2 / (1 + K sd^2)."""
    rows = sd * torch.tensor([[1.0, 0.0]] * 3, dtype=torch.float64)
    nothing = torch.tensor([[0.0, 1e-3 * sd]], dtype=torch.float64)
    found = plan_measurements([nothing, rows], rows[:1], 1)
    assert found.chosen == [1]
    assert float(found.variances[1]) == pytest.approx(sd**2 / (1 + 3 * sd**2), rel=1e-6)
    assert float(variance_with([rows, rows], rows[:1])) == pytest.approx(sd**2 / (1 + 6 * sd**2), rel=1e-6)


def factors_of(run, times, covariance):
    start = torch.tensor([0.5, 0.0], dtype=torch.float64)
    return prediction_factors(run.dynamics, start, times, run.dt, run.knowledge(covariance))


def least_squares(rows, forecast):
    """The trace of the forecast's covariance by the normal equations."""
    information = np.eye(forecast.shape[1]) + sum(part.numpy().T @ part.numpy() for part in rows)
    return np.trace(forecast.numpy() @ np.linalg.inv(information) @ forecast.numpy().T)


@pytest.mark.parametrize("seed", range(5))
def test_a_plan_is_the_best_in_which_no_single_choice_can_be_exchanged(seed):
    candidates, forecast = drawn(seed)
    plan = plan_measurements(candidates, forecast, 3)
    assert len(set(plan.chosen)) == 3
    for k in range(4):
        there = [candidates[c] for c in plan.chosen[:k]]
        close(plan.variances[k], torch.tensor(least_squares(there, forecast)), 1e-12)
        close(variance_with(there or [forecast[:0]], forecast), plan.variances[k], 1e-12)
    for out, other in itertools.product(plan.chosen, range(7)):
        if other not in plan.chosen:
            mine = [candidates[other if c == out else c] for c in plan.chosen]
            assert least_squares(mine, forecast) >= float(plan.variances[-1]) * (1 - 1e-5)


def test_exchanges_find_what_single_choices_miss():
    """Alone, a measurement of both unknowns is best; two precise ones of one unknown each are better."""
    forecast = torch.eye(2, dtype=torch.float64)
    candidates = [3 * forecast, 10 * forecast[:1], 10 * forecast[1:]]
    plan = plan_measurements(candidates, forecast, 2)
    assert sorted(plan.chosen) == [1, 2]
    close(plan.variances, torch.tensor([2.0, 1 + 1 / 101, 2 / 101], dtype=torch.float64), 1e-12)


def test_no_more_are_chosen_than_there_are():
    candidates, forecast = drawn(0)
    plan = plan_measurements(candidates, forecast, 20)
    assert sorted(plan.chosen) == list(range(7))
    close(plan.variances[-1], torch.tensor(least_squares(candidates, forecast)), 1e-12)


def test_equal_spacing_takes_both_ends_and_no_sample_twice():
    assert evenly_spaced(11, 3) == [0, 5, 10]
    assert evenly_spaced(3, 5) == [0, 1, 2]


def test_factors_have_the_covariance_of_a_prediction(tmp_path, cache):
    run = small(tmp_path / "run", cache, band=True)
    times = torch.tensor([0.0, 0.1, 0.35], dtype=torch.float64)
    covariance = torch.tensor([[0.04, 0.01], [0.01, 0.09]], dtype=torch.float64)
    states, factors = factors_of(run, times, covariance)
    found = run.predict([0.5, 0.0], times, start_covariance=covariance)
    close(states, found.states[0], 1e-12)
    close(factors @ factors.mT, found.covariances[0], 1e-5)  # that of a prediction in float32


def test_the_first_of_two_fixes_of_a_spring_is_where_it_tells_most(tmp_path, cache, monkeypatch, capsys):
    """From an almost exact position, a fix a quarter of a period later tells the momentum."""
    monkeypatch.chdir(tmp_path)
    run = small(tmp_path / "run", cache)
    words = f"run={run.folder}", "start=[0.5,0]", "start_sd=[1e-4,0.1]", "position_sd=1e-3"
    assert call("ahnn.plan", *words, "duration=2", "every=0.1", "choose=2", "output=plan.csv") == 0
    rows = list(csv.DictReader((tmp_path / "plan.csv").read_text().splitlines()))
    assert [row["instrument"] for row in rows] == ["fix", "fix"]
    times = torch.arange(0, 2.05, 0.1, dtype=torch.float64)
    _, factors = factors_of(run, times, torch.tensor([1e-8, 1e-2]).double().diag())
    left = [least_squares([factors[k, :1] / 1e-3], factors[-1, :1]) for k in range(21)]
    assert float(rows[0]["begin [s]"]) == pytest.approx(float(times[int(np.argmin(left))]))
    assert float(rows[0]["sd_after [m]"]) == pytest.approx(math.sqrt(min(left)), rel=1e-4)
    assert "2 sessions at equal spacing" in capsys.readouterr().out


def test_sessions_of_stations_are_within_their_passes_and_no_longer(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "stations.yaml").write_text(STATIONS)
    words = "stations=stations.yaml", "session=6h", "choose=3", "output=plan.csv"
    assert call("ahnn.plan", *ASKED, *words, "epoch=2024-03-01T12:00:00") == 0
    rows = list(csv.DictReader((tmp_path / "plan.csv").read_text().splitlines()))
    assert len(rows) == 3
    assert rows[0]["instrument"] == "hawaii"  # the other's range is off by 50 km
    assert all(int(row["measurements"]) <= 3 for row in rows)
    assert all(
        "2024-03-01T12:00:00" <= row["begin [UTC]"] <= row["end [UTC]"] <= "2024-03-02T12:00:00"
        for row in rows
    )
    spreads = [float(row["sd_after [km]"]) for row in rows]
    assert all(after < before for before, after in itertools.pairwise(spreads))
    assert "position sd [km]" in capsys.readouterr().out
    (tmp_path / "plan.csv").write_text("not ours\n")
    assert call("ahnn.plan", *ASKED, *words) == 2
    assert (tmp_path / "plan.csv").read_text() == "not ours\n"


def test_values_stand_in_one_column_whatever_the_length_of_a_name():
    table = [(name, "2024-03-01T12:00:00", "2024-03-01T13:00:00", 6) for name in ("a", "hartebeesthoek")]
    lines = aligned(lines_of(table, [3.0, 2.0, 1.0], "km"))
    assert len({len(line) for line in lines}) == 1
    assert all("measurements " in line for line in lines[2:])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("every=2h",), "plan: expected stations=FILE or position_sd=NUMBER; received neither"),
        (("position_sd=0.1", "every=0"), "every: expected a positive duration"),
        (("every=2h", "position_sd=0.1", "start_sd=null"), "start: expected one state with its"),
        (("every=2h", "stations=far.yaml"), "plan: expected a station that sees the object"),
        (("every=2h", "stations=far.yaml", "choose=0"), "choose"),
    ],
)
def test_one_message_for_each_mistake(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "far.yaml").write_text(
        "far: {latitude: 0, longitude: 0, min_elevation: 89.9, noise: {range: 1}}"
    )
    assert call("ahnn.plan", *ASKED, "choose=2", *words) == 2
    assert said in capsys.readouterr().err

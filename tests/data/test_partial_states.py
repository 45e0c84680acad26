"""Positions at every time with velocities at a few of them."""

from __future__ import annotations

import pytest
import torch
from entry import call
from test_own_data import SD, SMALL, swings

import ahnn
from ahnn.data import Given, SplitData
from ahnn.data.datamodule import Segments
from ahnn.data.recorded_sensor import Recorded
from ahnn.errors import UserError
from ahnn.measurements.smoothing import as_states, guess, smoothed

SPACE = ahnn.Space("files", ("q", "pq"), ahnn.Units("s", "m", "m/s", "m²/s²"))


def rows(path, *, every, of="v"):
    """The file of `swings` in which the column v (or q) has a number only in each `every`-th row."""
    lines = swings(path, 4, SD).read_text().splitlines()
    for k, line in enumerate(lines[1:], 1):
        name, t, q, v = line.split(",")
        there = (k - 1) % 61 % every == 0
        lines[k] = ",".join(
            (name, t, q, v if there else "") if of == "v" else (name, t, q if there else "", v)
        )
    path.write_text("\n".join(lines) + "\n")
    return path


def split_of(every: int) -> SplitData:
    """Exact oscillations at omega = 2 with rare momenta, as measurements."""
    t = 0.05 * torch.arange(61, dtype=torch.float64)
    phase = torch.arange(20, dtype=torch.float64).unsqueeze(1)
    states = torch.stack(((2 * t + phase).cos(), -2 * (2 * t + phase).sin()), dim=-1)
    states[:, torch.arange(61) % every > 0, 1] = torch.nan
    source = Given(ahnn.Trajectories(states, t), SPACE)
    return SplitData(source, [0.6, 0.2, 0.2], Recorded(SPACE, measured="state", noise=SD))


@pytest.mark.parametrize("every", [2, 3, 20])
def test_momenta_are_estimated_from_positions_where_few_are_measured(every):
    data = split_of(every)
    measured, instrument = data.measured("train"), data.instrument()
    assert instrument.sparse_momenta
    segments = Segments(measured, 10, instrument)
    assert len(segments) == 12 * (measured.times.shape[1] - 10)
    batch = segments.gather(torch.arange(len(segments)))
    start, time = guess(batch), batch.times[:, 0] * 2
    amplitude = (start[:, 0] ** 2 + (start[:, 1] / 2) ** 2).sqrt()
    assert bool((amplitude - 1).abs().max() < 1e-3), time
    local = smoothed(instrument, *measured, 500)
    states = as_states(local.value, local.rate, instrument)
    assert bool(((states[:, 0] ** 2 + (states[:, 1] / 2) ** 2).sqrt() - 1).abs().max() < 1e-3)


def test_measured_momenta_are_used_where_few_are_missing():
    data = split_of(1)
    data.measured("train").values[0, ::7, 1] = torch.nan
    assert not data.instrument().sparse_momenta


@pytest.mark.slow
def test_a_training_uses_rows_without_velocity(tmp_path):
    data = rows(tmp_path / "a.csv", every=3)
    given = ["model=ahnn", "hamiltonian=mechanical", f"data.noise={SD}", "loss.stages=[[16, 1.0]]"]
    given += ["trainer.max_epochs=6", f"run={tmp_path / 'run'}"]
    assert call("ahnn.train", *SMALL, f"system.path={data}", *given) == 0
    fit = ahnn.load(tmp_path / "run").results.numbers["measurements"]
    assert 0.5 < fit["chi_square"] < 2.0


@pytest.mark.parametrize(
    ("every", "of", "overrides", "expected"),
    [
        (3, "q", [], "at least 4 of 6 consecutive measurements of the position or state"),
        (
            3,
            "v",
            ["recipe=noisy_states", "loss.stages=[[weak, 1.0]]"],
            "Choose recipe=measurements, which uses",
        ),
    ],
)
def test_rows_that_cannot_be_used_are_one_message(tmp_path, capfd, every, of, overrides, expected):
    data = rows(tmp_path / "a.csv", every=every, of=of)
    given = [
        "model=ahnn",
        "hamiltonian=mechanical",
        f"data.noise={SD}",
        *overrides,
        f"run={tmp_path / 'run'}",
    ]
    assert call("ahnn.train", *SMALL, f"system.path={data}", *given) == 2
    assert expected in capfd.readouterr().err


def test_smoothing_refuses_samples_without_neighbours():
    data = split_of(1)
    measured, instrument = data.measured("train"), data.instrument()
    measured.values[:, torch.arange(61) % 30 > 0] = torch.nan
    with pytest.raises(
        UserError, match="expected trajectories with at least 4 of 6 consecutive measurements"
    ):
        smoothed(instrument._replace(sparse_momenta=True), *measured, 500)

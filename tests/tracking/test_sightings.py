"""Trainings on what stations measured, and streams whose start is fitted to it, beside the true orbit."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest
import torch
from entry import call

import ahnn
from ahnn.data.files.epochs import SECOND, instant, spelled
from ahnn.errors import UserError
from ahnn.measurements import StationsOfFile, observe
from ahnn.systems import Molniya
from ahnn.systems.truth import exact_flow
from ahnn.tracking.earth_axes import earth_axes
from ahnn.tracking.sightings import Sightings

ZERO = instant("2026-03-01T00:00:00", utc=True)
FRAME = "CIRS of 2026-03-01T00:00:00, EARTH, UTC, from 2026-03-01T00:00:00.000"
NOISE = "noise: {range: 0.02, azimuth: 0.01, elevation: 0.01"
STATIONS = f"""
kiruna: {{latitude: 67.86, longitude: 20.96, {NOISE}}}, bias: {{range: 0.5}}}}
poker: {{latitude: 65.12, longitude: 212.57, {NOISE}}}}}
awarua: {{latitude: -46.53, longitude: 168.38, {NOISE}, range_rate: 1.0e-5}}}}
unused: {{latitude: 0.0, longitude: 0.0}}
"""
HEAD = "time,station,range_km,azimuth_deg,elevation_deg,range_rate_km_s"
STEP = 300.0


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Three days of an orbit of three hours that three stations see, with noise."""
    folder = tmp_path_factory.mktemp("sightings")
    (folder / "stations.yaml").write_text(STATIONS)
    shape = {"altitude": (1200.0, 1200.0), "eccentricity": (0.4, 0.4), "inclination": (50.0, 50.0)}
    system = Molniya(name="s", dt=STEP, steps=864, raan=(40.0, 40.0), **shape)
    states, flow = [system.initial_states(1, torch.Generator().manual_seed(1))], exact_flow(system)
    for _ in range(system.steps):
        states.append(flow(states[-1], STEP))
    truth = torch.cat(states)
    times = STEP * torch.arange(len(truth), dtype=torch.float64)
    names = ("kiruna", "poker", "awarua")
    model = StationsOfFile(str(folder / "stations.yaml"), earth_axes(FRAME), only=names)
    noise = torch.randn(len(truth), len(model.names), generator=torch.Generator().manual_seed(2)).double()
    seen = observe(model, truth, times) + noise * torch.tensor(model.deviations).double()
    lines = [HEAD]
    for k in range(len(truth)):
        first = 0
        for name, one in model.stations.items():
            own, first = seen[k, first : first + len(one.names)].tolist(), first + len(one.names)
            if own[0] == own[0]:
                cells = [own[0], math.degrees(own[1]), math.degrees(own[2]), *own[3:]]
                text = [repr(cell) for cell in cells] + [""] * (4 - len(cells))
                epoch = spelled(ZERO + round(STEP * k * SECOND), utc=True)
                lines.append(",".join([epoch, name, *text]))
    (folder / "seen.yaml").write_text("event: bounce")
    (folder / "seen.csv").write_text("\n".join(lines) + "\n")
    return folder, truth, seen


def test_the_source_has_what_the_stations_saw(place):
    folder, truth, seen = place
    source = Sightings("mine", str(folder / "seen.csv"), str(folder / "stations.yaml"), cut=100)
    values, times = source.observations()
    assert source.measurement.names[0] == "kiruna.range"
    assert source.space.frame == FRAME
    k = (times / STEP).round().nan_to_num(0).long()
    assert torch.allclose(times, k.double() * STEP + 0 * times, rtol=1e-12, equal_nan=True)
    expected = torch.where(values.isfinite(), seen[k], torch.nan)
    apart = source.measurement.residual(values, expected).nan_to_num().abs()
    assert float(apart.max()) < 1e-9
    assert int(values.isfinite().sum()) == int(seen.isfinite().sum())
    shown = source.read().states[..., :3]
    off = (shown - truth[k][..., :3]).norm(dim=-1)
    assert float(off.nanmedian()) < 5.0  # 0.01 degrees at 15,000 km are 2.6 km
    assert source.recipe() != Sightings("m", str(folder / "seen.csv"), str(folder / "stations.yaml")).recipe()


def test_segments_that_determine_no_orbit_are_counted(place, caplog):
    folder, _, _ = place
    files = str(folder / "seen.csv"), str(folder / "stations.yaml")
    Sightings("whole", *files)
    assert "nothing is learned" not in caplog.text
    values, _ = Sightings("pieces", *files, cut=2).observations()
    few = int((values.isfinite().sum((1, 2)) <= 6).sum())
    assert 0 < few < len(values)
    assert f"pieces: {few} of {len(values)} segments have at most 6 measured values" in caplog.text
    assert caplog.messages[-1].endswith("Set a larger system.cut")


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        ("2026-03-01T00:00:00,krina,1,2,3,", "stations.yaml: expected stations krina; received none"),
        ("2026-03-01T00:00:00,poker,1,2,3,", "stations: poker.event: expected receive, as"),
        ("2026-03-01T00:00:00,unused,1,2,3,", "stations.yaml: unused.noise: expected standard deviations"),
        ("2026-03-01T00:00:00,poker,1,2,3,\n" * 2, "expected range of poker once at each time; received"),
    ],
)
def test_stations_that_are_not_known_and_repeated_lines_are_refused(place, tmp_path, seen, said):
    (tmp_path / "seen.csv").write_text(f"{HEAD}\n{seen}")
    (tmp_path / "seen.yaml").write_text("event: receive" if "event" in said else "event: bounce")
    with pytest.raises(UserError, match=r".") as caught:
        Sightings("mine", str(tmp_path / "seen.csv"), str(place[0] / "stations.yaml"))
    assert said in str(caught.value)


def nees(rows, truth):
    """Of the estimates of an output, over the six components."""
    names, found = ("x", "y", "z", "vx", "vy", "vz"), []
    for row in rows:
        off = np.array([float(row[name]) for name in names]) - truth[round(float(row["time"]) / STEP)].numpy()
        lower = [[float(row[f"cov_{a}_{b}"]) for b in names[: i + 1]] for i, a in enumerate(names)]
        covariance = np.array([row + [0.0] * (6 - len(row)) for row in lower])
        covariance += np.tril(covariance, -1).T
        found.append(off @ np.linalg.solve(covariance, off) / 6)
    return np.array(found)


@pytest.mark.slow
def test_a_model_learned_from_sightings_predicts_and_follows_the_true_orbit(place, tmp_path, caplog):
    folder, truth, _ = place
    words = ["system=sightings", f"system.path={folder / 'seen.csv'}", "sensor=recorded", "plugins=none"]
    words += [f"system.stations={folder / 'stations.yaml'}", "system.cut=80", "hamiltonian=perturbed_body"]
    words += ["inputs=isotropic", "data=in_time", "budget=smoke", "logger=none", f"run={tmp_path / 'run'}"]
    assert call("ahnn.train", *words) == 0
    numbers = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert 0.8 < numbers["plugins"]["measurements"]["chi_square"] < 1.4
    assert call("ahnn.evaluate", f"run={tmp_path / 'run'}", "evaluation.figures=false") == 0
    # What the training has not seen: the last quarter of the lines.
    lines = (folder / "seen.csv").read_text().splitlines()
    (tmp_path / "later.csv").write_text("\n".join([lines[0], *lines[-len(lines) // 4 :]]) + "\n")
    follow = [f"run={tmp_path / 'run'}", f"measurements={tmp_path / 'later.csv'}", "start=fit"]
    follow += [f"stations={folder / 'stations.yaml'}", f"output={tmp_path / 'out.csv'}"]
    assert call("ahnn.assimilate", *follow) == 0
    assert "start: fitted to the first 20 measurements, up to line 21" in caplog.text
    with (tmp_path / "out.csv").open() as file:
        found = nees([*csv.DictReader(file)], truth)
    assert found[0] < 16.8 / 6 * 2  # 16.8: chi-square of six, 1 in 100
    assert 0.2 < float(np.median(found)) < 4
    run = ahnn.load(tmp_path / "run")
    ahead = run.predict(truth[:1], [0.0, 6 * 3600.0])
    off = (ahead.states[0, -1] - truth[72]).numpy()
    assert off @ np.linalg.solve(ahead.covariances[0, -1].numpy(), off) < 16.8 * 2

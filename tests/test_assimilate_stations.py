"""A stream of stations that stand in a file beside the same stations one by one on the command line."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest
import yaml
from entry import call

import ahnn
from ahnn.measurements import GroundStation

START = [0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]
SITES = {"kiruna": (67.86, 20.96), "troll": (-72.0, 2.5)}
SD = [0.05, 2e-4, 2e-4, 1e-5]


def test_stations_of_a_file_are_followed_as_those_of_the_command_line(tmp_path, capsys):
    orbit = ahnn.load("molniya_mechanical").rollout(START, 12, 15.0)[0]
    lines, text = [], []
    for k in range(1, 13):
        name = [*SITES][k % 2]
        model, t = GroundStation(*SITES[name], range_rate=True), 15.0 * k
        seen = dict(zip(model.names, model(orbit[k], t).tolist(), strict=True))
        lines.append(json.dumps({"time": t, "sensor": name, **seen}))
    (tmp_path / "seen.jsonl").write_text("\n".join(lines) + "\n")
    degrees = [math.degrees(sd) for sd in SD]
    for name, site in SITES.items():
        noise = f"{{range: {SD[0]}, azimuth: {degrees[1]!r}, elevation: {degrees[2]!r}, range_rate: {SD[3]}}}"
        text.append(f"{name}: {{latitude: {site[0]}, longitude: {site[1]}, noise: {noise}}}")
    (tmp_path / "stations.yaml").write_text("\n".join(text))
    words = ["pretrained=molniya_mechanical", f"measurements={tmp_path / 'seen.jsonl'}", f"start={START}"]
    words += ["start_sd=[0.1,1e-4]", "plugins.ukf.process_noise=[1e-3,1e-5]"]
    one_by_one = []
    for name, (latitude, longitude) in SITES.items():
        model = f"sensors.{name}.model"
        one_by_one += [f"+measurement@sensors.{name}=ground_station", f"{model}.latitude={latitude}"]
        one_by_one += [f"{model}.longitude={longitude}", f"sensors.{name}.sd={SD}"]
    tracks = []
    for k, more in enumerate([[f"stations={tmp_path / 'stations.yaml'}"], one_by_one]):
        out = tmp_path / f"{k}.csv"
        assert call("ahnn.assimilate", *words, *more, f"output={out}") == 0
        with out.open() as file:
            names = "x", "y", "z", "vx", "vy", "vz"
            tracks.append(np.array([[float(row[name]) for name in names] for row in csv.DictReader(file)]))
    units = yaml.safe_load((tmp_path / "0.yaml").read_text())["units"]
    assert units["cov_x_x"] == "km^2"
    assert (units["cov_vy_x"], units["cov_vz_vy"]) == ("km^2/s", "km^2/s^2")
    for prefix in ("innovation_", "innovation_sd_"):
        measured = [units[prefix + name] for name in ("range", "azimuth", "elevation", "range_rate")]
        assert measured == ["km", "rad", "rad", "km/s"]
    assert tracks[0].shape == (12, 6)
    assert np.allclose(tracks[0], tracks[1], rtol=1e-9)
    assert call("ahnn.assimilate", *words, "stations=nowhere.yaml") == 2
    assert "nowhere.yaml: expected" in capsys.readouterr().err
    for more, said in (
        (["fitted=3"], "fitted: expected start=fit"),
        (one_by_one, "stations: expected no other sen"),
    ):
        assert call("ahnn.assimilate", *words, "stations=nowhere.yaml", *more) == 2
        assert said in capsys.readouterr().err


@pytest.mark.parametrize("objects", [False, True])
def test_a_station_at_a_wrong_place_is_named(tmp_path, caplog, objects):
    orbit = ahnn.load("molniya_mechanical").rollout(START, 24, 15.0)[0]
    noise = f"noise: {{range: {SD[0]}, azimuth: 0.01, elevation: 0.01}}"
    head = "time,sensor,range,azimuth,elevation"
    lines, text = [head + ",object" * objects], []
    for k in range(1, 25):
        name = [*SITES][k % 2]
        seen = GroundStation(*SITES[name])(orbit[k], 15.0 * k).tolist()
        lines.append(",".join(map(str, [15.0 * k, name, *seen])) + ",a" * objects)
    for name, longitude in (("kiruna", -20.96), ("troll", 2.5)):  # of kiruna with the wrong sign
        text.append(f"{name}: {{latitude: {SITES[name][0]}, longitude: {longitude}, {noise}}}")
    (tmp_path / "seen.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "stations.yaml").write_text("\n".join(text))
    words = ["pretrained=molniya_mechanical", f"measurements={tmp_path / 'seen.csv'}", f"start={START}"]
    words += ["start_sd=[0.1,1e-4]", "plugins.ukf.process_noise=[1e-3,1e-5]", "plugins.ukf.patience=100"]
    words += [f"stations={tmp_path / 'stations.yaml'}", f"output={tmp_path / 'out.csv'}"]
    assert call("ahnn.assimilate", *words, *["objects=object"] * objects) == 0
    said = "12 of 12 lines of kiruna were rejected: check its coordinates, units and noise"
    assert said in caplog.text
    assert "of troll were" not in caplog.text

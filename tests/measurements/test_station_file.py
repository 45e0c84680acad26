"""Stations in a file beside the same stations one by one."""

from __future__ import annotations

import math

import pytest
import torch

from ahnn.errors import UserError
from ahnn.measurements import GroundStation, StationsOfFile, noise_deviations, observe
from ahnn.measurements.station_file import BiasedStation, read_stations

TEXT = """
kiruna:
  latitude: 67.86
  longitude: 20.96
  height: 400
  min_elevation: 10
  noise: {range: 0.05, azimuth: 0.01, elevation: 0.02}
  bias: {range: 0.02, azimuth: 0.1}
  bias_sd: {range: 0.1}
troll: {latitude: -72.0, longitude: 2.5, noise: {range_rate: 1.0e-5}}
"""
X = torch.tensor([[3000.0, 1500.0, 8000.0, 1.0, 2.0, -3.0], [0.0, 1e4, 0.0, 1.0, 2.0, -3.0]])
X = X.double()


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "stations.yaml"
    path.write_text(TEXT)
    return path


def test_they_measure_as_one_by_one_with_their_biases_masks_and_noise(file):
    model, kiruna = StationsOfFile(str(file)), GroundStation(67.86, 20.96, 0.4, min_elevation=10.0)
    troll = GroundStation(-72.0, 2.5, range_rate=True)
    assert model.names == ("kiruna.range", "kiruna.azimuth", "kiruna.elevation", "troll.range_rate")
    wanted = kiruna(X, 60.0) + torch.tensor([0.02, math.radians(0.1), 0.0]).double()
    assert torch.allclose(model(X, 60.0)[:, :3], wanted, rtol=1e-7)
    assert torch.allclose(model(X, 60.0)[:, 3], troll(X, 60.0)[:, 3], rtol=1e-13)
    seen = observe(model, X, 60.0).isfinite()
    assert torch.equal(seen[:, :3], kiruna.in_view(X, 60.0))
    assert seen.any()
    assert not seen.all()
    sds = [0.05, math.radians(0.01), math.radians(0.02), 1e-5]
    assert noise_deviations(model, None, "sd").tolist() == pytest.approx(sds)
    station = BiasedStation(read_stations(file)["kiruna"])
    assert torch.allclose(station.locate(station(X, 60.0), 60.0), X[:, :3], atol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("latitude: 67.86", "latitude: 97", "kiruna.latitude: expected"),
        (
            "range: 0.05",
            "rnage: 0.05",
            "kiruna.noise: expected one of range, azimuth, elevation, range_rate; received",
        ),
        ("azimuth: 0.01", "azimuth: -1", "kiruna.noise.azimuth: expected a number > 0; received -1"),
        ("longitude: 2.5, ", "", "troll: "),
        ("height: 400", "hieght: 400", "did you mean 'height'"),
        (
            "noise: {range_rate: 1.0e-5}",
            "bias: {range: 1}",
            "noise: expected standard deviations of one or more",
        ),
        (TEXT, "{}", "expected at least one station; received none"),
        (TEXT, "kiruna: here", "kiruna: expected [latitude, longitude, height] in degrees and m, or keys"),
    ],
)
def test_what_is_wrong_is_said(file, old, new, said):
    file.write_text(TEXT.replace(old, new))
    with pytest.raises(UserError) as error:
        StationsOfFile(str(file))
    assert said in str(error.value)

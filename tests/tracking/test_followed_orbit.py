"""A filter with the forces, stations and biases of an orbit determination beside the batch fit itself."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from earth import EPOCH, REAL, bodies
from entry import call
from orbit_folder import orbit_folder, true_arc
from simulated import STATIONS, data, gravity, learned

from ahnn.data.files.epochs import SECOND
from ahnn.data.files.messages import read_oem
from ahnn.tracking.formats.tdm_writing import write_tdm
from ahnn.tracking.formats.tracking_files import read_tracking
from ahnn.tracking.orbit_belief import fitted_belief
from ahnn.tracking.satellite_arc import Forces
from ahnn.tracking.satellite_flow import SatelliteFlow
from ahnn.tracking.station_measurement import StationMeasurement
from ahnn.tracking.tracking_data import KINDS, joined
from ahnn.tracking.tracking_model import Corrections, TrackingModel

pytest.importorskip("erfa")
pytest.importorskip("de421")
pytest.importorskip("astropy_iers_data")
SETUPS = Path(__file__).parents[2] / "docs" / "orbits"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return orbit_folder(tmp_path_factory.mktemp("orbit"), {"south": 0.05}, count=24)


def follow(folder, tmp_path, *words):
    made = [f"output={tmp_path / 'track.csv'}", f"oem={tmp_path / 'track.oem'}"]
    return call("ahnn.assimilate", f"orbit={folder / 'setup.yaml'}", "orbit.biases.range=0.1", *made, *words)


def last_of(path):
    (orbit,) = read_oem(path)
    return np.asarray(orbit.states)[-1], np.asarray(orbit.covariances[-1].matrix), orbit


@pytest.fixture(scope="module")
def batch(folder, tmp_path_factory):
    """The fit of all measurements: state and covariance at the end of its ephemeris, and the ephemeris."""
    out = tmp_path_factory.mktemp("batch")
    assert call("ahnn.orbit", str(folder / "setup.yaml"), f"out={out}", "biases.range=0.1", "step=1e9") == 0
    return last_of(out / "orbit.oem")


def at_the_end_of(track, batch):
    """The position of the fit where a track ends, less than a second earlier: back by two bodies."""
    state, _, orbit = batch
    (r, v), lag = np.split(state, 2), orbit.times[-1] - track.times[-1]
    lag += (orbit.start - track.start) / SECOND
    assert 0.0 <= lag < 1.0
    return r - lag * v - lag**2 / 2 * 398600.4415 * r / np.linalg.norm(r) ** 3


@pytest.mark.parametrize("plugin", ["ekf", "ukf"])
@pytest.mark.sampled(2)
def test_a_filter_ends_where_the_fit_of_all_measurements_does(folder, batch, plugin, tmp_path, caplog):
    assert follow(folder, tmp_path, "start=fit", "fitted=30", f"plugins={plugin}") == 0
    state, covariance, orbit = last_of(tmp_path / "track.oem")
    known = batch[1]
    sd = np.sqrt(np.diagonal(known))
    assert (state[:3] - at_the_end_of(orbit, batch)) / sd[:3] == pytest.approx(0.0, abs=1e-3)
    assert covariance / np.outer(sd, sd) == pytest.approx(known / np.outer(sd, sd), abs=0.02)
    assert orbit.frame == "GCRF"
    assert "18 taken" in caplog.text
    bias, known_to = re.search(r"south +range, m .*? ([\d.]+) +([\d.]+) +fits", caplog.text).groups()
    assert abs(float(bias) - 50) < 3 * float(known_to) < 50


def test_measurements_in_another_file_are_followed_as_if_in_the_same(folder, tmp_path):
    (whole,) = read_tracking(folder / "seen.aer")
    first, rest = (select(whole, rows) for rows in (slice(None, 24), slice(24, None)))
    both, own = joined(first, rest)
    assert own.tolist() == [True] * 24 + [False] * 24
    for name in ("times", "values", "station"):
        assert getattr(both, name) == pytest.approx(getattr(whole, name), abs=1e-9, nan_ok=True)
    write_tdm(tmp_path / "rest.xml", [rest])
    lines = (folder / "seen.aer").read_text().splitlines()[:24]
    for name, text in (("seen.aer", "\n".join(lines)), ("seen.yaml", (folder / "seen.yaml").read_text())):
        (tmp_path / name).write_text(text)
    (tmp_path / "setup.yaml").write_text((folder / "setup.yaml").read_text())
    tracks = []
    for k, words in enumerate(
        (
            [f"orbit={folder / 'setup.yaml'}", "fitted=24"],
            [f"orbit={tmp_path / 'setup.yaml'}", f"measurements={tmp_path / 'rest.xml'}"],
        )
    ):
        out = tmp_path / f"{k}.csv"
        assert call("ahnn.assimilate", *words, "start=fit", f"output={out}", "plugins=ekf", "gate=none") == 0
        tracks.append(numbers(out))
    assert (len(tracks[0]), len(tracks[1])) == (24, 12)  # a message has range and angles of a time together
    assert tracks[0][1::2] == pytest.approx(tracks[1], rel=1e-6)


def select(whole, rows):
    parts = {
        n: getattr(whole, n)[rows]
        for n in ("times", "values", "station", "weather", "wavelength", "deviations")
    }
    return replace(whole, **parts)


def numbers(path):
    with path.open() as file:
        return np.array(
            [[float(row[name]) for name in ("x", "y", "z", "vx", "vy", "vz")] for row in csv.DictReader(file)]
        )


def test_a_given_start_is_followed_and_a_stopped_stream_goes_on(folder, tmp_path, caplog):
    words = [
        "orbit.noise.range=0.02",
        "start_sd=[10,0.01]",
        "plugins=ekf",
        "plugins.ekf.estimator.iterations=5",
    ]
    words += [f"state={tmp_path / 'a.state'}", "every=20"]
    assert follow(folder, tmp_path, *words) == 0
    _, arc = true_arc()
    state, covariance, orbit = last_of(tmp_path / "track.oem")
    off = state - arc.states(np.array([(orbit.start - EPOCH) / 1e12 + orbit.times[-1]]))[0]
    assert off @ np.linalg.solve(covariance, off) < 30  # of 6, six times in ten million
    (nis,) = re.findall(r"mean NIS per value (\S+);", caplog.text)
    assert 0.4 < float(nis) < 1.4  # ranges are twice as good as is said
    before = (tmp_path / "track.csv").read_bytes()
    assert follow(folder, tmp_path, *words) == 0
    assert "resuming after line 49" in caplog.text
    assert (tmp_path / "track.csv").read_bytes() == before


def test_what_a_station_should_measure_of_a_state_is_what_it_should_of_the_path():
    rotation, arc = true_arc()
    for event in ("receive", "transmit", "bounce"):
        taken = replace(data(event, count=9), values=np.ones((9, 6)))
        model = TrackingModel(taken, STATIONS, Corrections(troposphere="radio"), rotation, bodies())
        wanted = model(arc).values
        for n, t in enumerate(taken.times):
            x = torch.from_numpy(np.concatenate((arc.states(np.array([t]))[0], [0.25])))[None]
            station = StationMeasurement(model, int(taken.station[n]), KINDS, (6, *[None] * 5))
            found = station(x, float(t))[0].numpy() - [0.25, 0, 0, 0, 0, 0]
            assert found[[0, 1, 2, 4, 5]] == pytest.approx(wanted[n, [0, 1, 2, 4, 5]], abs=1e-8)
            assert found[3] == pytest.approx(wanted[n, 3], abs=2e-7)
            slope, half = station.slope(x, float(t))[0], torch.tensor([1e-2] * 3 + [1e-2] * 3 + [1e-2])
            for k in range(7):
                step = torch.zeros(7, dtype=torch.float64)
                step[k] = half[k]
                moved = station(torch.stack((x[0] + step, x[0] - step)), float(t))
                difference = (moved[0] - moved[1]) / (2 * half[k])
                assert slope[:, k].numpy() == pytest.approx(difference.numpy(), abs=3e-5, rel=1e-4)


def test_the_flow_is_the_path_and_its_transition_the_sensitivities():
    _, arc = true_arc()
    forces = Forces([gravity(), learned()], 450.0)
    free = np.arange(len(forces.parameters)) < 9
    flow = SatelliteFlow(forces, np.linspace(-5, 5, len(free)), free)
    x = torch.from_numpy(np.concatenate((arc.states(np.zeros(1))[0], np.linspace(-3, 3, 9), [7.0])))[None]
    after, moved = flow.at(100.0).transition(x, 900.0)
    assert flow.at(100.0)(x, 900.0).numpy() == pytest.approx(after.numpy(), rel=1e-11)
    assert after[0, 6:].tolist() == x[0, 6:].tolist()
    for k, half in enumerate([1.0] * 3 + [1e-3] * 3 + [5.0] * 9 + [1.0]):
        step = torch.zeros_like(x)
        step[0, k] = half
        slope = (flow.at(100.0)(x + step, 900.0) - flow.at(100.0)(x - step, 900.0)) / (2 * half)
        assert moved[0, :, k].numpy() == pytest.approx(slope[0].numpy(), rel=2e-4, abs=1e-8)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["start=fit"], "fitted: expected the number or fraction of measurements"),
        (["start=fit", "fitted=30", "epoch=2024-01-01"], "epoch: expected none with orbit="),
        (["start=fit", "fitted=30", "run=a"], "run: expected a key that applies with orbit="),
        (["start=fit", "fitted=30", "plugins=none"], "plugins: expected one that filters online"),
        (["start=fit", "fitted=30", "plugins.ukf.process_noise=force_error"], "process_noise: expected [POS"),
        (["start=fit", "fitted=30", "orbit.noise.rnage=1"], "noise: unknown key 'rnage'"),
        (["orbit.biases.azimuth=inf", "start_sd=[1,1]"], "a finite standard deviation of bias "),
        (["measurements=nowhere.tdm", "start_sd=[1,1]"], "nowhere.tdm"),
        ([], "start_sd: expected"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(folder, tmp_path, words, said, capsys):
    assert follow(folder, tmp_path, *words) == 2
    error = capsys.readouterr().err
    assert said in error
    assert "Traceback" not in error
    assert not [*tmp_path.iterdir()]


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
@pytest.mark.parametrize("plugin", ["ekf", "ukf"])
def test_the_last_fifth_of_w3b_is_followed_as_it_comes(tmp_path, plugin, caplog):
    words = [f"folder={REAL / 'w3b'}", "start=fit", f"plugins={plugin}", f"oem={tmp_path / 'track.oem'}"]
    words.append(f"output={tmp_path / 'track.csv'}")
    assert call("ahnn.assimilate", f"orbit={SETUPS / 'w3b.yaml'}", *words) == 0
    assert "104 taken" in caplog.text
    _, castle = re.search(r"CastleRock +range, m +38 +(\S+) +(\S+)", caplog.text).groups()
    assert float(castle) < 6
    _, covariance, _ = last_of(tmp_path / "track.oem")
    assert np.sqrt(np.trace(covariance[:3, :3])) < 5


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
def test_lageos_is_followed_to_where_the_prediction_has_it(tmp_path, caplog):
    words = [f"folder={REAL / 'lageos2'}", "start=fit", "fitted=0.6", "orbit.noise_estimated=false"]
    words += ["plugins.ukf.process_noise=[0,1e-10]", f"output={tmp_path / 'track.csv'}"]
    assert call("ahnn.assimilate", f"orbit={SETUPS / 'lageos2.yaml'}", *words) == 0
    assert "38 taken" in caplog.text
    assert float(re.search(r"(\S+) m at most", caplog.text)[1]) <= 1.0


def test_the_covariance_at_the_start_of_a_filter_is_symmetric_to_the_last_bit():
    draw = np.random.default_rng(0)
    root = draw.normal(size=(6, 6)) * 10.0 ** draw.uniform(-6, 0, 6)
    moved, states = draw.normal(size=(1, 6, 6)), np.zeros((1, 6))
    arc = SimpleNamespace(sensitivities=lambda _: moved, states=lambda _: states)
    unknowns = SimpleNamespace(free=np.ones(6, dtype=bool), forces=0, names=tuple("abcdef"))
    problem, point = SimpleNamespace(unknowns=unknowns), SimpleNamespace(arc=arc, x=np.zeros(6))
    fit = SimpleNamespace(problem=problem, point=point, covariance=root @ root.T, noise=None)
    found = fitted_belief(fit, 0.0).covariance  # pyright: ignore[reportArgumentType]
    assert (found == found.T).all()

"""The command: measurements go in, tables, an orbit and words come out, or one line of what is wrong."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from earth import EPOCH, REAL
from entry import call
from orbit_folder import orbit_folder
from simulated import TRUE

from ahnn.cli.pairs import divided
from ahnn.data.files.messages import read_oem
from ahnn.errors import TrainingError
from ahnn.jobs import determining
from ahnn.tracking.orbit_problem import measured
from ahnn.tracking.orbit_setup import OrbitSetup

pytest.importorskip("erfa")
pytest.importorskip("de421")
pytest.importorskip("astropy_iers_data")
SETUPS = Path(__file__).parents[2] / "docs" / "orbits"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the measurements of a known orbit and a setup."""
    place = orbit_folder(tmp_path_factory.mktemp("orbit"))
    for name in ("named.aer", "setup.aer"):
        (place / name).write_text((place / "seen.aer").read_text())
    (place / "named.yaml").write_text("object: W3B\nunits: {RANGE: km, AZ_EL: deg}\n")
    return place


def test_measurements_without_a_name_have_that_of_the_setup(folder):
    setup = OrbitSetup(measurements="seen.aer", object="MY GTO")
    assert measured(setup, folder).object == "MY GTO"
    named = replace(setup, measurements="named.aer", object="W3B")
    assert measured(named, folder).object == "W3B"


def test_an_orbit_is_found_and_written(folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert call("ahnn.orbit", str(folder / "setup.yaml"), f"out={out}", "held_out=0.2") == 0
    said = capsys.readouterr().out
    assert "180 measurements of 3 stations" in said
    assert "converged" in said
    assert "times: of reception (event: receive), in UTC" in said
    assert "light time" not in said
    assert re.search(r"all range: 60 with a standard deviation of (8|9|10|11)\.?\d* m", said)
    assert "the last 24 of 120 times, unseen" in said
    (orbit,) = read_oem(out / "orbit.oem")
    assert orbit.frame == "GCRF"
    assert (orbit.start - EPOCH) % 10**12 == 0
    assert set(np.diff(orbit.times)[:-1]) == {300.0}
    start = np.argmin(np.abs((orbit.start - EPOCH) / 1e12 + orbit.times))
    known = np.sqrt(np.diagonal(np.asarray(orbit.covariances[start].matrix)))
    assert (known[:3] < 0.05).all()
    assert (known[:3] > 1e-5).all()
    with (out / "residuals.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 180
    assert {row["fitted"] for row in rows} == {"1"}
    inside = [abs(float(row["residual"])) < 2 * float(row["sd"]) for row in rows]
    assert 0.85 < np.mean(inside) < 1.0
    with (out / "unknowns.csv").open() as file:
        unknowns = {row["name"]: row for row in csv.DictReader(file)}
    assert {(row["epoch_utc"], row["frame"]) for row in unknowns.values()} == {
        ("2016-02-13T16:00:00.000", "GCRF")
    }
    assert [row["unit"] for row in unknowns.values()] == ["km"] * 3 + ["km/s"] * 3
    assert "estimated state: GCRF, at 2016-02-13T16:00:00.000 UTC" in (out / "summary.txt").read_text()
    off = float(unknowns["x"]["value"]) - TRUE[0]
    assert abs(off) < 4 * float(unknowns["x"]["sd"])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["noise.rnage=1"], "noise: unknown key 'rnage'; did you mean 'range'?"),
        (["noise.range=-1"], "noise.range: expected a standard deviation > 0; received -1"),
        (["noise.azimuth=null"], "noise.azimuth: expected a standard deviation for"),
        (["start.epoch=yesterday"], "start.epoch: expected an epoch such as"),
        (["start.position=[1,2]"], "start.position: expected three numbers"),
        (["forces.gravity.field=nowhere.gfc"], "nowhere.gfc: expected a file with a gravity field"),
        (["forces.gravity.degree=40"], "degree: expected 0 to 12 for EIGEN-6S; received 40"),
        (["forces.drag=heavy"], "forces.drag: expected a mapping of keys to values; received 'heavy'"),
        (["stations.south=[1,2]"], "stations.south: expected [latitude, longitude, height] in degrees and m"),
        (["stations.west=[1,2,3]"], "stations.west: expected a station in seen.aer"),
        (["sinex=[a.snx]"], "stations: expected coordinates under `stations`, or files"),
        (["object=other", "measurements=named.aer"], "object: expected one object in named.aer (W3B"),
        (["measurements=setup.aer"], "setup.yaml: expected one of the keys object, clock, event, units"),
        (["measurements=nowhere.aer"], "nowhere.aer"),
        (["held_out=1"], "held_out: expected float from 0 to 0.9; received 1"),
        (["corrections.troposphere=wet"], "corrections.troposphere: expected one of none, radio, laser"),
        (["folder=/nowhere"], "folder: expected the folder of the measurements; received /nowhere"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(folder, words, said, capsys):
    assert call("ahnn.orbit", str(folder / "setup.yaml"), *words, f"out={folder / 'new' / 'out'}") == 2
    error = capsys.readouterr().err
    assert said in error
    assert "Traceback" not in error
    assert "system.path" not in error
    assert not (folder / "new").exists()


@pytest.mark.parametrize(
    ("mistakes", "said"),
    [
        (
            ["south has a wrong position"],
            "orbit: south has a wrong position (the fit of all measurements failed)",
        ),
        ([], "no step. Give a closer start"),
    ],
)
def test_a_failed_fit_names_its_cause_in_place_of_a_remedy_that_does_not_help(
    folder, capsys, monkeypatch, mistakes, said
):
    def failed(_):
        raise TrainingError("no step. Give a closer start")

    monkeypatch.setattr(determining, "orbit_fit", failed)
    monkeypatch.setattr(determining, "suspected_mistakes", lambda *_: mistakes)
    (folder / "old").mkdir(exist_ok=True)
    (folder / "old" / "notes.txt").write_text("mine")
    for name in ("old", "new"):
        assert call("ahnn.orbit", str(folder / "setup.yaml"), f"out={folder / name}") == 3
    assert [path.name for path in (folder / "old").iterdir()] == ["notes.txt"]
    assert not (folder / "new").exists()
    error = capsys.readouterr().err
    assert said in error
    assert ("closer start" in error) == (not mistakes)


def test_an_empty_name_of_the_output_folder_is_refused(folder, capsys):
    assert call("ahnn.orbit", str(folder / "setup.yaml"), "out=") == 2
    assert "out: expected a folder; received none" in capsys.readouterr().err


def test_a_command_without_a_file_says_how(capsys):
    assert call("ahnn.orbit") == 2
    assert "usage: python -m ahnn.orbit FILE.yaml" in capsys.readouterr().err
    assert divided(["a=b"]) == ([], ["a=b"])


def test_somebodys_file_is_not_replaced(folder, tmp_path, capsys):
    (tmp_path / "residuals.csv").write_text("mine\n")
    assert call("ahnn.orbit", str(folder / "setup.yaml"), f"out={tmp_path}") == 2
    assert "residuals.csv" in capsys.readouterr().err
    assert (tmp_path / "residuals.csv").read_text() == "mine\n"
    assert [one.name for one in tmp_path.iterdir()] == ["residuals.csv"]


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
def test_w3b_is_fitted_as_well_as_by_orekit_and_its_future_is_known_to_within_what_is_said(tmp_path, capsys):
    where = f"folder={REAL / 'w3b'}"
    assert call("ahnn.orbit", str(SETUPS / "w3b.yaml"), where, f"out={tmp_path}") == 0
    said = capsys.readouterr().out
    sds = {
        kind: float(sd) for kind, sd in re.findall(r"all (\w+): \d+ with a standard deviation of (\S+)", said)
    }
    assert sds["range"] <= 4.37
    assert sds["azimuth"] <= 0.0101
    assert sds["elevation"] <= 0.0116
    leak, sd = map(float, re.search(r"at the start, .*?: (\S+) ± (\S+),", said).groups())
    assert abs(leak - 8.005e-6) < 2 * sd < 1.6e-5
    learned, plain = map(float, re.findall(r"all (\d+\.\d) % of 165", said))
    assert 90 <= learned <= 99
    assert plain < 80


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
@pytest.mark.parametrize("learned", [False, True])
def test_lageos_is_where_the_prediction_has_it(learned, capsys):
    words = ["forces.learned.unit=1e-12", "noise_estimated=false"] if learned else []
    assert call("ahnn.orbit", str(SETUPS / "lageos2.yaml"), f"folder={REAL / 'lageos2'}", *words) == 0
    said = capsys.readouterr().out
    assert float(re.search(r"all range: 95 with a standard deviation of (\S+)", said)[1]) <= 0.30
    assert float(re.search(r"(\S+) m at most", said)[1]) <= 1.0

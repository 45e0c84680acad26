"""Mean elements in four notations, against the two lines of the same set and against the package sgp4."""

from __future__ import annotations

import io

import numpy as np
import pytest
from entry import call
from made_orbits import OMM, omm

from ahnn.data.files import Files, instant, read_oem
from ahnn.data.files.kinds import kind_of
from ahnn.data.files.omm import omm_content
from ahnn.errors import UserError

pytest.importorskip("sgp4")
LINES = (
    "1 00005U 58002B   00179.78495062  .00000023  00000-0  28098-4 0  4753\n"
    "2 00005  34.2682 348.7242 1859667 331.7664  19.3264 10.82419157413667\n"
)
NOTATIONS = ("xml", "kvn", "csv", "json")
ALL = pytest.mark.parametrize("notation", NOTATIONS)


def read(text, note=None):
    more = {} if note is None else {"note": note}
    return omm_content(text, "a.omm", 60.0, 6000.0, **more)


@ALL
def test_they_are_the_two_lines_of_the_same_set(notation, tmp_path):
    (tmp_path / "a.txt").write_text(omm(notation))
    (tmp_path / "b.txt").write_text(LINES)
    one, other = (Files("a", str(tmp_path / name), step=60, duration=6000) for name in ("a.txt", "b.txt"))
    assert abs(one.epoch - other.epoch) < 10**6  # a microsecond
    assert one.space.frame.partition(" from ")[0] == "TEME, EARTH, UTC,"
    near = one.trajectories.states - other.trajectories.states
    assert near.abs().max() < 1e-5  # km: epochs of two lines end after 8 decimals of a day


@ALL
def test_they_are_what_the_package_makes_of_them(notation):
    from sgp4 import omm as theirs
    from sgp4.api import Satrec

    fields = {
        **OMM,
        "EPOCH": "2024-02-29T18:50:19.733568",
        "MEAN_MOTION": "2.00568723",
        "ECCENTRICITY": "0.72",
    }
    (track,) = read(omm(notation, fields)).tracks
    satellite = Satrec()
    theirs.initialize(satellite, next(theirs.parse_csv(io.StringIO(omm("csv", fields)))))
    days = satellite.jdsatepochF + track.times / 86400
    errors, q, v = satellite.sgp4_array(np.full(len(days), satellite.jdsatepoch), days)
    assert not errors.any()
    assert np.allclose(track.values, np.hstack((q, v)), rtol=1e-9, atol=1e-9)


@ALL
def test_epoch_name_and_what_is_not_used(notation):
    notes = []
    found = read(omm(notation), notes.append)
    assert found.epoch == instant("2000-06-27T18:50:19.733568", utc=True)
    assert found.tracks[0].name == "5"
    assert [one.what[:55] for one in notes] == ["not used: classes, mean motion derivatives, set and rev"]


def test_several_messages_are_several_trajectories():
    other = {**OMM, "NORAD_CAT_ID": "6", "EPOCH": "2000-06-28T00:00:00.000000"}
    texts = {
        "xml": omm("xml").replace("</ndm>", "") + omm("xml", other).replace("<ndm>", ""),
        "kvn": omm("kvn") + omm("kvn", other),
        "csv": omm("csv") + omm("csv", other).splitlines()[1] + "\n",
        "json": omm("json").rstrip()[:-1] + "," + omm("json", other)[1:],
    }
    for text in texts.values():
        found = read(text)
        assert [track.name for track in found.tracks] == ["5", "6"]
        assert found.tracks[1].times[0] == pytest.approx(18580.266432, abs=1e-6)


@ALL
@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("MEAN_MOTION", "x", "column MEAN_MOTION: expected a number"),
        ("MEAN_MOTION", "1e9", "column MEAN_MOTION: expected a number from 0.001 to 20"),
        ("ECCENTRICITY", "1.5", "column ECCENTRICITY: expected a number from 0 to"),
        ("INCLINATION", "", "column INCLINATION: expected a value in an orbit mean-elements message (OMM)"),
        ("EPOCH", "2000-06-31T00:00:00", "column EPOCH: expected a calendar date"),
        ("EPOCH", "1900-06-30T00:00:00", "column EPOCH: expected an epoch from 1957 to 2100"),
        ("EPHEMERIS_TYPE", "4", "column EPHEMERIS_TYPE: expected 0 or 2; received '4'"),
        ("BSTAR", "1e4", "column BSTAR: expected a number from -100 to 100"),
        ("REF_FRAME", "EME2000", "column REF_FRAME: expected TEME or TEMEOFDATE; received 'EME2000'"),
        ("MEAN_ELEMENT_THEORY", "DSST", "column MEAN_ELEMENT_THEORY: expected SGP4 or SGP/SGP4"),
    ],
)
def test_what_sgp4_does_not_take_is_refused_by_its_keyword(notation, key, value, said):
    if notation == "csv" and key in ("REF_FRAME", "MEAN_ELEMENT_THEORY"):
        pytest.skip("CSV has no such column")
    with pytest.raises(UserError) as caught:
        read(omm(notation, {**OMM, key: value}))
    assert str(caught.value).startswith("a.omm, row ")
    assert said in str(caught.value)


def test_elements_that_decay_and_other_theories_and_units():
    with pytest.raises(UserError, match="elements that SGP4 can propagate"):
        read(omm("kvn", {**OMM, "MEAN_MOTION": "17.5", "ECCENTRICITY": "0.5"}))
    with pytest.raises(UserError, match="received SEMI_MAJOR_AXIS, which belongs to another theory"):
        read(omm("kvn", {**OMM, "SEMI_MAJOR_AXIS": "8000"}))
    with pytest.raises(UserError, match=r"column INCLINATION: expected units deg; received 'rad'"):
        read(omm("kvn", {**OMM, "INCLINATION": "0.5 [rad]"}))
    with pytest.raises(UserError, match="expected JSON"):
        read(omm("json")[:-3])
    with pytest.raises(UserError, match="expected an object with a text or number for each keyword"):
        read("[1, 2]")


@ALL
def test_a_prediction_begins_at_their_epoch(notation, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = f"start.{'json' if notation == 'json' else 'txt'}"
    (tmp_path / name).write_text(omm(notation))
    more = ["duration=2min", "step=1min", "output=out.oem", "frame=[GCRF,EARTH]"]
    assert call("ahnn.predict", "pretrained=molniya_mechanical", f"start={name}", *more) == 0
    (found,) = read_oem("out.oem")
    assert (found.frame, found.start) == ("GCRF", instant("2000-06-27T18:50:19.733568", utc=True))
    (tmp_path / "b.txt").write_text(LINES)
    other = Files("b", "b.txt", step=60, duration=600, frame="GCRF").trajectories.states[0, 0]
    assert np.allclose(found.states[0], other.numpy(), rtol=1e-8, atol=1e-5)


def test_kinds_are_told_by_content():
    for notation in NOTATIONS:
        assert kind_of(omm(notation).encode(), "a.txt") == "omm"

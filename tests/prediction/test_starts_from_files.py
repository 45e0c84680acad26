"""`predict start=FILE`: epoch, frame, centre and covariance of a file are used or refused."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import torch
from entry import call
from helpers import close, framed

import ahnn
from ahnn.data.files import Covariance, Ephemeris, Files, instant, read_oem, write_oem
from ahnn.data.reference import Reference
from ahnn.errors import UserError

MOLNIYA = "pretrained=molniya_mechanical"
STATE = np.array([0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0])
NOON = instant("2024-03-01T12:00:00", utc=True)
P = np.diag([4.0, 1.0, 9.0, 4e-6, 1e-6, 9e-6])
SHORT = ["duration=2min", "step=1min"]


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def message(frame="EME2000", center="EARTH", state=STATE, clock="UTC", axes=None):
    """An ephemeris of one state, its covariance in some axes."""
    known = () if axes is None else (Covariance(0.0, P, axes),)
    write_oem("start.oem", [Ephemeris("A", "A", center, frame, clock, NOON, np.zeros(1), state[None], known)])
    return "start=start.oem"


def first(path="out.csv"):
    return next(csv.DictReader(Path(path).read_text().splitlines()))


def deviations(row):
    return [float(row[f"sd_{name}"]) for name in ("x [km]", "y [km]", "z [km]", "vx [km/s]")]


@pytest.mark.parametrize(
    ("given", "more", "said"),
    [
        ({"frame": "ITRF2014"}, [], "expected an inertial frame; received ITRF2014. Set frame= to"),
        ({"center": "MARS"}, [], "expected centre EARTH, as in the model; received MARS"),
        ({"center": "MARS"}, ["frame=[GCRF,EARTH]"], "expected centre EARTH, as in the model"),
        ({}, ["frame=[TNW,EARTH]"], "expected frame TNW, as in the model; received EME2000"),
        ({"frame": "TNW"}, ["frame=[GCRF]"], "expected frame GCRF, as in the model; received TNW"),
        ({"clock": "UT1"}, ["frame=[EME2000,EARTH,UTC]"], "time system: expected UT1, or both of UTC"),
        ({}, ["epoch=2024-03-01T12:00:00"], "epoch: expected none, since the start file has its own"),
        ({}, ["output=null", "covariances=true"], "covariances: expected output=FILE, a table to contain"),
        ({"axes": "TNW"}, [], "expected a covariance in EME2000 or RTN; received one in TNW"),
    ],
)
def test_what_does_not_fit_the_model_is_one_message(given, more, said, capsys):
    message(**given)
    assert call("ahnn.predict", MOLNIYA, "start=start.oem", *SHORT, "output=out.csv", *more) == 2
    assert said in capsys.readouterr().err
    assert not Path("out.csv").exists()


def test_a_start_is_turned_into_the_frame_of_the_model_with_its_covariance(caplog):
    run = framed(Path("run"), "GCRF, EARTH, UTC, from 2026-01-01T00:00:00.000")
    start = message("ITRF2014", axes="ITRF2014")
    assert call("ahnn.predict", f"run={run}", start, *SHORT, "output=out.oem") == 0
    assert not [text for text in caplog.messages if "rotates" in text]
    (found,) = read_oem("out.oem")
    assert (found.frame, found.center, found.time_system, found.start) == ("GCRF", "EARTH", "UTC", NOON)
    turned = Files("turned", "start.oem", frame="GCRF").read().states[0, 0]
    close(torch.from_numpy(found.states[0]), turned, 1e-14)

    def moved(k):
        """A state that is off by a unit, turned."""
        message("ITRF2014", state=STATE + np.eye(6)[k])
        return Files("turned", "start.oem", frame="GCRF").read().states[0, 0] - turned

    m = torch.stack([moved(k) for k in range(6)], dim=1)
    expected = m @ torch.from_numpy(P) @ m.mT
    scale = expected.diagonal().sqrt()
    difference = torch.from_numpy(found.covariances[0].matrix) - expected
    assert float((difference / torch.outer(scale, scale)).abs().max()) < 1e-6


def test_the_covariance_of_the_first_state_goes_along_and_start_sd_takes_its_place(caplog):
    start = message(axes="EME2000")
    assert call("ahnn.predict", MOLNIYA, start, *SHORT, "output=out.csv") == 0
    assert deviations(first()) == pytest.approx([2, 1, 3, 2e-3], rel=1e-12)
    run = ahnn.load("molniya_mechanical")
    found = run.predict(STATE, [0.0, 60.0, 120.0], start_covariance=P).deviations
    last = list(csv.DictReader(Path("out.csv").read_text().splitlines()))[-1]
    assert deviations(last) == pytest.approx(found[0, -1, :4].tolist(), rel=1e-12)
    assert call("ahnn.predict", MOLNIYA, start, *SHORT, "output=out.csv", "start_sd=[5,0.1]") == 0
    assert deviations(first()) == pytest.approx([5, 5, 5, 0.1], rel=1e-12)
    Path("a.yaml").write_text(
        "mean: [0, -3145, -6173, 10, 0, 0]\nsd: [1, 0.01]\nepoch: 2024-03-01T12:00:00\n"
    )
    assert call("ahnn.predict", MOLNIYA, "start=a.yaml", *SHORT, "output=b.csv", "start_sd=[5,0.1]") == 0
    assert deviations(first("b.csv"))[0] == pytest.approx(5)
    assert "start_sd replaces the covariance in a.yaml" in caplog.text
    assert first("b.csv")["epoch"] == "2024-03-01T12:00:00.000"


@pytest.mark.parametrize(("name", "told"), [("o.oem", "COMMENT "), ("o.xml", "<COMMENT>"), ("o.csv", "# ")])
def test_whoever_receives_a_file_reads_the_warnings_about_its_bands(name, told):
    slow = np.array([0.0, -3145.0, -6173.0, 9.0, 0.0, 0.0])
    start = message(state=slow, axes="EME2000")
    assert call("ahnn.predict", MOLNIYA, start, "duration=90min", "step=30min", f"output={name}") == 0
    lines = Path("o.yaml" if name == "o.csv" else name).read_text().splitlines()
    assert max(map(len, lines)) <= 254
    remarks = " ".join(line.strip() for line in lines if line.strip().startswith(told))
    assert f"{told}1 sigma: from the start only; these weights carry no uncertainty in the dyn" in remarks
    assert f"{told}novelty: " in remarks
    if name == "o.oem":
        assert lines[0].startswith("CCSDS_OEM_VERS")
        assert lines[1].startswith("COMMENT")
    if name == "o.csv":
        assert Files("again", name).epoch == NOON
    else:
        assert len(read_oem(name)[0].covariances) == 4


def test_axes_along_the_orbit_are_turned_into_those_of_the_state():
    along = np.array([0.0, 7000.0, 0.0, -7.5, 0.0, 0.0])  # radial y, transverse -x
    start = message(state=along, axes="RTN")
    assert call("ahnn.predict", MOLNIYA, start, *SHORT, "output=out.csv") == 0
    assert deviations(first()) == pytest.approx([1, 2, 3, 1e-3], rel=1e-12)


def test_a_covariance_of_another_epoch_is_not_that_of_the_start(caplog):
    two = Ephemeris("A", "A", "EARTH", "EME2000", "UTC", NOON, np.array([0.0, 60.0]), np.stack([STATE] * 2))
    write_oem("start.oem", [two._replace(covariances=(Covariance(60.0, P),))])
    assert call("ahnn.predict", MOLNIYA, "start=start.oem", *SHORT, "output=out.csv") == 0
    assert "the covariances are not used, since they belong to other epochs than the states" in caplog.text
    assert "sd_x [km]" not in first()


def test_element_sets_begin_where_sgp4_has_them():
    api = pytest.importorskip("sgp4.api", reason="the extra `orbit` is needed")
    lines = [
        "1 00005U 58002B   00179.78495062  .00000023  00000-0  28098-4 0  4753",
        "2 00005  34.2682 348.7242 1859667 331.7664  19.3264 10.82419157413667",
    ]
    Path("start.tle").write_text("\n".join(lines) + "\n")
    assert call("ahnn.predict", MOLNIYA, "start=start.tle", *SHORT, "output=out.oem") == 0
    (found,) = read_oem("out.oem")
    satellite = api.Satrec.twoline2rv(*lines)
    _, position, velocity = satellite.sgp4(satellite.jdsatepoch, satellite.jdsatepochF)
    assert (found.frame, found.object_id) == ("TEME", "1958-002B")
    assert np.allclose(found.states[0], [*position, *velocity], rtol=1e-12, atol=0)


@pytest.mark.parametrize("name", ["orbit.csv", "orbit.oem"])
def test_a_start_that_the_program_wrote_causes_no_remarks_on_training(name, caplog):
    caplog.set_level("INFO")
    assert call("ahnn.predict", MOLNIYA, message(axes="EME2000"), *SHORT, f"output={name}") == 0
    caplog.clear()
    assert call("ahnn.predict", MOLNIYA, f"start={name}", *SHORT) == 0
    assert "training" not in caplog.text
    assert "name them" not in caplog.text
    Path("orbit.csv").write_text("t,x,y,z,vx,vy,vz,note\n0,0,-3145,-6173,10,0,0,1\n")
    names = "columns: {time: t, positions: [x, y, z], velocities: [vx, vy, vz]}\n"
    Path("orbit.yaml").write_text(names)
    assert call("ahnn.predict", MOLNIYA, "start=orbit.csv", *SHORT) == 0
    assert "the sidecar does not name them: note" in caplog.text


def test_a_table_hands_on_the_covariances_of_its_states():
    """The axes along the orbit are oblique to those of the state: standard deviations are not enough."""
    direct = ["duration=2h", "step=1h", "output=direct.oem"]
    assert call("ahnn.predict", MOLNIYA, message(axes="RTN"), *direct) == 0
    known = read_oem("direct.oem")[0].covariances[-1].matrix
    for more, alike in (["covariances=true"], True), ([], False):
        assert call("ahnn.predict", MOLNIYA, "start=start.oem", *SHORT, "output=orbit.csv", *more) == 0
        assert any(name.startswith("cov_y_x") for name in first("orbit.csv")) is alike
        assert call("ahnn.predict", MOLNIYA, "start=orbit.csv", *direct[:2], "output=again.oem") == 0
        found = read_oem("again.oem")[0].covariances[-1].matrix
        assert np.allclose(found, known, rtol=1e-6, atol=0) is alike


def test_what_a_prediction_wrote_is_a_start_with_its_frame_and_its_epoch():
    assert call("ahnn.predict", MOLNIYA, message(), *SHORT, "output=orbit.csv") == 0
    assert call("ahnn.predict", MOLNIYA, "start=orbit.csv", *SHORT, "output=again.oem") == 0
    (found,) = read_oem("again.oem")
    assert (found.frame, found.center, found.time_system, found.start) == ("EME2000", "EARTH", "UTC", NOON)
    files = Files("orbit", "orbit.csv")
    assert files.epoch == NOON
    close(files.read().states[0, 0], torch.from_numpy(STATE), 1e-15)
    Path("mine.yaml").write_text("columns: {}\n")
    assert call("ahnn.predict", MOLNIYA, "start=orbit.csv", *SHORT, "output=mine.csv") == 2
    assert Path("mine.yaml").read_text() == "columns: {}\n"


def test_a_message_has_frame_and_epoch_of_the_data_that_were_learned(capsys):
    run = framed(Path("run"), "GCRF, EARTH, TAI, from 2026-01-01T00:00:00.000")
    numbers = f"start={STATE.tolist()}".replace(" ", "")
    assert call("ahnn.predict", f"run={run}", numbers, *SHORT, "output=out.oem") == 0
    (found,) = read_oem("out.oem")
    assert (found.frame, found.time_system, found.epoch(0.0)) == ("GCRF", "TAI", "2026-01-01T00:00:00.000")
    assert call("ahnn.predict", f"run={run}", numbers, *SHORT, "output=out.oem", "frame=[EME2000]") == 2
    assert (
        "frame: expected GCRF, as in the model; received EME2000. Leave it out; ahnn.predict converts"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize("frame", ["GCRF", "EME2000"])
def test_a_prediction_in_cirs_is_converted_with_its_covariances(frame):
    run = framed(Path("run"), "CIRS, EARTH, UTC, from 2026-01-01T00:00:00.000")
    start = message("CIRS", axes="CIRS")
    for output, more in (("own.oem", []), ("out.oem", [f"output_frame={frame}"])):
        assert call("ahnn.predict", f"run={run}", start, *SHORT, f"output={output}", *more) == 0
    (own,), (found,) = read_oem("own.oem"), read_oem("out.oem")
    assert (own.frame, found.frame, found.start) == ("CIRS", frame, NOON)
    turned = Files("turned", "own.oem", frame=frame).read().states[0]
    close(torch.from_numpy(found.states), turned, 1e-14)
    for k in range(3):
        r = turned[k, :3].numpy(), own.states[k, :3]
        one, other = found.covariances[k].matrix[:3, :3], own.covariances[k].matrix[:3, :3]
        assert r[0] @ one @ r[0] == pytest.approx(r[1] @ other @ r[1], rel=1e-9)
        assert not np.allclose(one, other, rtol=1e-6)
    erfa = pytest.importorskip("erfa")
    tt = erfa.taitt(*erfa.utctai(*erfa.dtf2d("UTC", 2024, 3, 1, 12, 0, 0.0)))
    turn = erfa.c2ixys(*erfa.xys06a(*tt)).T  # from CIRS to GCRF
    turn = erfa.bp00(*tt)[0] @ turn if frame == "EME2000" else turn
    assert np.allclose(found.states[0, :3], turn @ own.states[0, :3], rtol=1e-11, atol=0)


@pytest.mark.parametrize("axes", ["CIRS", "TEME", "CIRS of 2026-01-01T00:00:00.000"])
def test_a_start_is_converted_to_moving_axes_and_its_prediction_back(axes):
    run = framed(Path("run"), f"{axes}, EARTH, UTC, from 2026-01-01T00:00:00.000")
    start = message("EME2000", axes="EME2000")
    assert call("ahnn.predict", f"run={run}", start, *SHORT, "output=own.oem") == 0
    back = ["output=back.oem", "output_frame=EME2000"]
    assert call("ahnn.predict", f"run={run}", start, *SHORT, *back) == 0
    (own,), (found,) = read_oem("own.oem"), read_oem("back.oem")
    assert [own.frame, own.frame_epoch, found.start] == [*[*axes.split(" of "), ""][:2], NOON]
    turned = Files("turned", "own.oem", frame="EME2000").read().states[0, 0]
    close(turned, torch.from_numpy(STATE), 1e-14)
    close(torch.from_numpy(found.states[0]), torch.from_numpy(STATE), 1e-14)
    assert np.allclose(found.covariances[0].matrix, P, rtol=1e-9, atol=1e-12)
    assert np.linalg.norm(own.states[0, :3] - STATE[:3]) > 1e-3 * np.linalg.norm(STATE[:3])


def test_a_frame_that_cannot_be_converted_is_one_message(capsys):
    numbers = f"start={STATE.tolist()}".replace(" ", "")
    for more, said in (
        ([], "received none. Name the frame of the model with frame="),
        (["frame=[CIRS,EARTH,UTC]"], "output_frame: expected an epoch"),
        (
            ["frame=[TNW,EARTH,UTC]"],
            "output_frame: expected a model in a frame of docs/frames.md; received TNW",
        ),
    ):
        arguments = [numbers, *SHORT, "output=out.csv", "output_frame=GCRF", *more]
        assert call("ahnn.predict", MOLNIYA, *arguments) == 2
        assert said in capsys.readouterr().err
        assert not Path("out.csv").exists()


def test_what_is_not_finite_ends_with_code_3_and_writes_nothing(capsys):
    near = "start=[1e-300,0,0,0,0,0]"
    assert call("ahnn.predict", MOLNIYA, near, *SHORT, "output=out.csv", "figure=out.png") == 3
    assert "received NaN or infinity 60 s after start 1" in capsys.readouterr().err
    assert [*Path().iterdir()] == []


@pytest.mark.parametrize("name", ["a.csv", "a.yaml", "a.oem", "a.tle", "a.json", "a.jsonl", "a.xml"])
def test_an_empty_file_is_no_start(name, capsys):
    Path(name).touch()
    assert call("ahnn.predict", MOLNIYA, f"start={name}", *SHORT) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_frames_of_the_earth_have_it_as_centre(caplog):
    known = [f"start={STATE.tolist()}", "epoch=2024-03-01T12:00:00", *SHORT]
    assert call("ahnn.predict", MOLNIYA, *known, "frame=EME2000", "output=out.oem") == 0
    assert read_oem("out.oem")[0].center == "EARTH"
    assert caplog.text.count("center: not stated; EARTH, the centre of EME2000, is assumed") == 1
    for other in (Reference("ICRF"), Reference("EME2000", "SUN")):
        assert other.centred("km") == other
    assert Reference("GCRF").centred("au").center == ""


def test_references_say_what_they_are_of_and_clocks_are_turned():
    text = "EME2000, EARTH, UTC, from 2024-03-01T12:00:00.000"
    noon = Reference.of(text)
    assert (noon.epoch, str(noon)) == (NOON, text)
    assert str(Reference.of("?, ?, UTC")) == "?, ?, UTC"
    assert Reference.of("j2000, Earth").turn(noon, "start") is None
    tai = noon.on("TAI")  # 37 s ahead of UTC since 2017
    assert str(tai).endswith("12:00:37.000")
    assert tai.on("UTC") == noon
    assert Reference.of("GCRF").filled(tai) == ("GCRF", "EARTH", "TAI", tai.epoch)
    with pytest.raises(UserError, match="center: expected EARTH, as in the model; received MOON"):
        noon.chosen(Reference.of("EME2000, MOON"))

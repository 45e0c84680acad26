"""What files are told by, and every field of them: used, refused, or said to be not used."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from made_files import orbit, refused, said

from ahnn.data import Files
from ahnn.data.files import Ephemeris, instant, kinds, read_oem, write_oem
from ahnn.data.files.table import Fault
from ahnn.errors import UserError

START = instant("2024-03-01T12:00:00", utc=True)


@pytest.fixture
def message(tmp_path):
    """An ephemeris of ten states, one a minute, as a text of keywords."""
    t, states = orbit(10)
    write_oem(tmp_path / "made.oem", [Ephemeris("1", "SAT", "EARTH", "EME2000", "UTC", START, t, states)])
    return (tmp_path / "made.oem").read_text()


@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("name", ["a.txt", "a.dat", "a", "a.csv"])
def test_a_message_is_one_whatever_its_name_and_the_ends_of_its_lines(tmp_path, message, name, ends):
    (tmp_path / name).write_bytes(message.replace("\n", ends).encode())
    found, notes = said(tmp_path / name)
    assert np.allclose(found.tracks[0].values, orbit(10)[1], rtol=1e-14, atol=0)
    assert [one.what for one in notes] == []


def test_a_table_is_one_whatever_the_ends_of_its_lines(tmp_path):
    text = "id,t [s],q [m]\na,0,1\na,1,2\nb,0,x\n"
    for ends in ("\n", "\r\n", "\r"):
        (tmp_path / "a.csv").write_bytes(text.replace("\n", ends).encode())
        assert "row 4, column q: expected a number; received 'x'" in refused(tmp_path / "a.csv")


FOREIGN = {
    "CCSDS_OPM_VERS = 2.0\n": "orbit parameter message (OPM)",
    "CCSDS_OMM_VERS = 2.0\n": "that SGP4 propagates from the mean elements (OMM)",
    "CCSDS_TDM_VERS = 1.0\n": "tracking data message (TDM)",
    "CCSDS_OCM_VERS = 3.0\n": "orbit comprehensive message (OCM)",
    "CCSDS_CDM_VERS = 1.0\n": "conjunction data message (CDM)",
    "CCSDS_AEM_VERS = 1.0\n": "attitude ephemeris message (AEM)",
    "CCSDS_XYZ_VERS = 1.0\n": "a CCSDS message XYZ",
    '<?xml version="1.0"?>\n<opm version="2.0"><body/></opm>': "orbit parameter message (OPM)",
    "<ndm><oem><body/></oem><tdm/></ndm>": "tracking data message (TDM)",
    "<html><body/></html>": "one with <html>",
    "#dP2024  3  1 12  0  0.00000000      96 ORBIT IGb20 HLM  IGS\n": "SP3",
    "H1 CPF  2  SGF 2016 02 13 01  544 lageos2\n": "CPF",
    "h1 crd  1 2016 02 14 00\n": "CRD",
    f"{'     3.04           OBSERVATION DATA':60}RINEX VERSION / TYPE\n": "RINEX",
    "%=SNX 2.01 IGN\n": "SINEX",
    "stk.v.11.0\nBEGIN Ephemeris\n": "STK",
    '[{"OBJECT_NAME": "ISS"}]': "JSON",
    "OBJECT_NAME,OBJECT_ID,EPOCH,MEAN_MOTION,ECCENTRICITY\nISS,1,2,3,4\n": "(OMM)",
    "PK\x03\x04 rest": "a zip archive",
    "\x1f": None,
    "t x v\n0 1 2\n": "expected columns separated by commas, semicolons or tabs",
}


@pytest.mark.parametrize("text", FOREIGN)
@pytest.mark.parametrize("name", ["a.txt", "a.oem", "a.csv"])
def test_other_formats_are_called_by_their_names(tmp_path, text, name):
    (tmp_path / name).write_text(text)
    if FOREIGN[text] is not None and not (name == "a.oem" and text.startswith("t x")):
        assert FOREIGN[text] in refused(tmp_path / name)
    else:
        assert "expected" in refused(tmp_path / name)


def test_every_message_of_ccsds_has_a_name(tmp_path):
    for name, about in kinds.MESSAGES.items():
        (tmp_path / "a.txt").write_text(f"CCSDS_{name}_VERS = 2.0\n")
        assert f"({name})" in about
        assert (about if name not in kinds.IN_WORDS else f"({name})") in refused(tmp_path / "a.txt")
        with pytest.raises(UserError, match=name):
            read_oem(tmp_path / "a.txt")


def changed(folder, text, *pairs):
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new, 1)
    (folder / "a.oem").write_text(text)
    return folder / "a.oem"


def test_states_outside_the_useable_span_are_no_data(tmp_path, message):
    span = (
        "META_STOP",
        "USEABLE_START_TIME = 2024-03-01T12:02:00\nUSEABLE_STOP_TIME = 2024-03-01T12:07:00\nMETA_STOP",
    )
    path = changed(tmp_path, message, span)
    found, notes = said(path)
    assert np.allclose(found.tracks[0].values, orbit(10)[1][2:8], rtol=1e-14, atol=0)
    assert (found.epoch, found.tracks[0].times[-1]) == (START + 120 * 10**12, 300.0)
    assert "4 of 10 states are outside USEABLE_START_TIME to USEABLE_STOP_TIME and not used" in notes[0].what
    (read,) = read_oem(path)
    assert np.allclose(read.states, orbit(10)[1][2:8], rtol=1e-14, atol=0)
    late = (span[0], span[1].replace("T12:07", "T11:00"))
    assert "a state between USEABLE_START_TIME" in refused(changed(tmp_path, message, late))


def test_what_is_not_used_is_said_once_and_logged(tmp_path, message, caplog):
    more = "INTERPOLATION = HERMITE\nINTERPOLATION_DEGREE = 7\nUSABLE_START_TIME = 2024-03-01\nMETA_STOP"
    first = next(line for line in message.splitlines() if line.startswith("2024"))
    path = changed(tmp_path, message, ("META_STOP", more), (first, f"COMMENT thrust\n{first} 0 0 0"))
    _, notes = said(path)
    assert [(one.level, one.what) for one in notes] == [
        ("warning", notes[0].what),
        ("note", "not used: X_DDOT, Y_DDOT, Z_DDOT, INTERPOLATION, INTERPOLATION_DEGREE"),
        ("note", "comments: thrust"),
    ]
    assert "USABLE_START_TIME is not an OEM keyword" in notes[0].what
    assert "did you mean 'USEABLE_START_TIME'?" in notes[0].what
    with caplog.at_level(logging.INFO):
        Files("orbit", str(path))
        assert caplog.text.count("not used: X_DDOT") == 1
        read_oem(path)
        assert caplog.text.count("not used: X_DDOT") == 2


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("= 2.0", "= 7.0", "expected OEM version 1.0, 2.0 or 3.0; received '7.0'"),
        (
            "ORIGINATOR",
            "SEMI_MAJOR_AXIS",
            "received 'SEMI_MAJOR_AXIS'. Give the ephemeris in a separate file",
        ),
        ("META_STOP\n", "META_STOP\nX = 7000 [km]\n", "expected a state, a covariance or META_START"),
        ("REF_FRAME", "REF_FRAME = GCRF\nREF_FRAME", "REF_FRAME: expected each keyword once"),
        ("META_STOP\n", "META_STOP\nCCSDS_OPM_VERS = 2.0\n", "Give the ephemeris in a separate file"),
    ],
)
def test_what_belongs_to_no_ephemeris_is_refused(tmp_path, message, old, new, expected):
    assert expected in refused(changed(tmp_path, message, (old, new)))


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "</data>",
            "<keplerianElements/></data>",
            "one with <keplerianElements>. Give the ephemeris in a separate file",
        ),
        ("<X>", "<X>1</X><X>", "column X: expected each element once"),
        ("<X_DOT>", '<X_DOT units="m/s">', "column X_DOT: expected units km/s; received 'm/s'"),
        ('version="2.0"', 'version="9"', "expected OEM version 1.0, 2.0 or 3.0"),
    ],
)
def test_what_belongs_to_no_ephemeris_in_xml_is_refused(tmp_path, old, new, expected):
    t, states = orbit(3)
    write_oem(tmp_path / "a.xml", [Ephemeris("1", "S", "EARTH", "EME2000", "UTC", START, t, states)])
    (tmp_path / "a.xml").write_text((tmp_path / "a.xml").read_text().replace(old, new, 1))
    assert expected in refused(tmp_path / "a.xml")


def test_a_covariance_has_an_epoch_and_a_frame_of_its_own_each_time(tmp_path, message):
    triangle = "\n".join(" ".join(["0"] * k + ["1"]) for k in range(6))
    blocks = "".join(
        f"EPOCH = 2024-03-01T12:0{k}:00\n{frame}{triangle}\n"
        for k, frame in enumerate(("COV_REF_FRAME = RTN\n", "", "COV_REF_FRAME = j2000\n"))
    )
    (tmp_path / "a.oem").write_text(f"{message}COVARIANCE_START\n{blocks}COVARIANCE_STOP\n")
    (read,) = read_oem(tmp_path / "a.oem")
    assert [(one.time, one.frame) for one in read.covariances] == [(0.0, "RTN"), (60.0, ""), (120.0, "")]


SPELLED = [
    (("J2000", "EARTH", "UTC"), ("EME2000", "Earth", "utc")),
    (("ITRF-97", "EARTH", "UTC"), ("itrf97", "earth", "UTC")),
    (("TEMEOFDATE", "EARTH", "UTC"), ("TEME", "EARTH", "UTC")),
    (("GCRF", "Ceres", "TDB"), ("gcrf", "CERES", "Tdb")),
]


@pytest.mark.parametrize(("one", "other"), SPELLED)
def test_one_frame_in_two_spellings_is_one(tmp_path, one, other):
    t, states = orbit(5)
    given = [
        Ephemeris("1", "S", center, frame, system, START + 10**12 * shift, t, states)
        for shift, (frame, center, system) in ((0, one), (900, other))
    ]
    write_oem(tmp_path / "both.oem", given)
    found, _ = said(tmp_path / "both.oem")
    assert [track.times[0] for track in found.tracks] == [0.0, 900.0]
    for k in (0, 1):
        write_oem(tmp_path / f"{k}.oem", [given[k]])
    assert len(Files("both", [str(tmp_path / f"{k}.oem") for k in (0, 1)]).names) == 2


def test_segments_of_two_frames_are_refused_unless_they_are_turned(tmp_path):
    pytest.importorskip("erfa")
    t, states = orbit(5)
    given = [Ephemeris("1", "S", "EARTH", f, "UTC", START, t, states) for f in ("GCRF", "EME2000")]
    write_oem(tmp_path / "a.oem", given)
    assert "expected frame GCRF in each segment; received EME2000. system.frame=GCRF" in refused(
        tmp_path / "a.oem"
    )
    found, _ = said(tmp_path / "a.oem", "GCRF")
    off = np.linalg.norm(found.tracks[0].values[:, :3] - found.tracks[1].values[:, :3], axis=1)
    assert np.allclose(found.tracks[0].values, states, rtol=1e-14, atol=0)
    assert bool(((off > 1e-5) & (off < 1e-3)).all())  # 23 thousandths of a second of arc, 0.8 m


@pytest.mark.parametrize("name", ["TEME", "TOD"])
def test_a_frame_of_a_date_is_not_that_of_another(tmp_path, message, name):
    moment = "2024-03-01T00:00:00"
    dated = message.replace("REF_FRAME = EME2000", f"REF_FRAME = {name}\nREF_FRAME_EPOCH = {moment}")
    (tmp_path / "a.oem").write_text(dated)
    found = said(tmp_path / "a.oem")[0]
    assert found.frame == f"{name} of {moment}, EARTH, UTC"
    if name == "TOD":
        with pytest.raises(Fault, match="expected a frame that can be converted to GCRF"):
            said(tmp_path / "a.oem", "GCRF")
        return
    (tmp_path / "b.oem").write_text(dated.replace(f"\nREF_FRAME_EPOCH = {moment}", ""))
    fixed, of_date = (said(tmp_path / file, "GCRF")[0].tracks[0].values for file in ("a.oem", "b.oem"))
    days = (found.epoch - instant(moment, utc=True)) / 86400e12
    off = np.linalg.norm(fixed[:, :3] - of_date[:, :3], axis=1) / np.linalg.norm(fixed[:, :3], axis=1)
    assert bool((off < 1e-6 + 3e-7 * abs(days)).all())  # precession is 50 seconds of arc a year
    assert bool((off > 0).all())


def test_a_sidecar_beside_a_message_is_said_to_be_not_used(tmp_path, message):
    (tmp_path / "a.oem").write_text(message)
    (tmp_path / "a.yaml").write_text("frame: TEME\n")
    (only,) = said(tmp_path / "a.oem")[1]
    assert (only.place.file, only.what[:8]) == (str(tmp_path / "a.yaml"), "not used")

"""Orbit ephemeris messages: read, written and read back, in both notations, and their faults."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ahnn.data import Files
from ahnn.data.files import Covariance, Ephemeris, instant, oem, oem_xml, read_oem, write_oem
from ahnn.data.files.ephemeris import COMPONENTS, ephemeris
from ahnn.data.files.epochs import LEAPS, SECOND, spelled
from ahnn.errors import UserError

HERE = Path(__file__).parents[2] / "fixtures" / "orbit.oem"
TEXT = HERE.read_text()


def read(text):
    return [ephemeris(block) for block in oem.blocks_of(text, "a.oem")]


def test_segments_states_epochs_and_covariances_are_read():
    first, second = read_oem(HERE)
    assert (first.object_name, first.object_id) == ("MOLNIYA", "1994-081A")
    assert (first.center, first.frame, first.time_system) == ("EARTH", "EME2000", "UTC")
    assert first.times.tolist() == [0.0, 61.0, 121.5]  # the last minute of 2016 had 61 seconds
    assert first.states[1].tolist() == [6990.0, 450.0, 15.0, -0.5, 7.48, 0.24]
    assert first.states[2, 0] == 6970.123456789012
    assert first.rows.tolist() == [18, 19, 20]
    (found,) = first.covariances
    assert (found.time, found.frame) == (61.0, "RTN")
    assert np.array_equal(found.matrix, found.matrix.T)
    assert np.diag(found.matrix).tolist() == [1e-2, 2e-2, 3e-2, 4e-8, 5e-8, 6e-8]
    assert found.matrix[0, 1] == 1e-3
    assert found.matrix[4, 5] == 1e-9
    assert second.start - first.start == 3661 * SECOND
    assert second.covariances == ()


NUMBERS = st.floats(-1e6, 1e6, allow_subnormal=False)


@given(
    states=arrays(float, (4, 6), elements=NUMBERS),
    steps=arrays(float, 3, elements=st.floats(1e-3, 1e5)),
    matrix=arrays(float, (6, 6), elements=NUMBERS),
    system=st.sampled_from(["UTC", "TAI", "TDB"]),
    start=st.integers(-(10**9), 10**9),
)
def test_what_is_written_is_read_back(states, steps, matrix, system, start):
    times = np.concatenate(([0.0], steps.cumsum()))
    covariance = Covariance(float(times[1]), matrix + matrix.T, "EME2000")
    given = Ephemeris("1", "SAT", "EARTH", "EME2000", system, start * SECOND, times, states, (covariance,))
    (got, other) = read(oem.written([given, given]))
    assert np.abs(got.states - states).max() <= 1e-9
    assert np.abs(got.times - times).max() <= 1e-9
    assert got[:6] == given[:6] == other[:6]
    assert np.allclose(got.covariances[0].matrix, covariance.matrix, rtol=1e-15, atol=0)
    assert got.covariances[0].time == pytest.approx(covariance.time, abs=1e-9)


@pytest.mark.parametrize("name", ["a.oem", "a.xml"])
def test_a_file_is_written_and_read_back(tmp_path, name):
    write_oem(tmp_path / name, read_oem(HERE))
    for got, expected in zip(read_oem(tmp_path / name), read_oem(HERE), strict=True):
        assert got[:6] == expected[:6]
        assert np.array_equal(got.states, expected.states)
        assert np.array_equal(got.times, expected.times)
        for one, other in zip(got.covariances, expected.covariances, strict=True):
            assert (one.time, one.frame) == (other.time, other.frame)
            assert np.array_equal(one.matrix, other.matrix)


@pytest.mark.parametrize("name", ["a.oem", "a.xml"])
def test_comments_are_printable_lines_within_the_limit_of_the_standard(tmp_path, name):
    write_oem(tmp_path / name, read_oem(HERE), comments=["first & <last>", "σ\n\a " + 99 * "band "])
    lines = (tmp_path / name).read_text(encoding="ascii").splitlines()
    assert max(map(len, lines)) <= 254
    found = [line.strip().replace("<COMMENT>", "COMMENT ") for line in lines if "COMMENT" in line]
    assert len(found) == 4
    assert found[1].startswith("COMMENT ? ? band")
    assert len(read_oem(tmp_path / name)) == len(read_oem(HERE))


def as_xml(text):
    """A message in XML with what `oem` finds in one of keywords."""
    parts = []
    for block in oem.blocks_of(text, "a.oem"):
        meta = "".join(f"<{key}>{value}</{key}>" for key, value in block.meta.items())
        data = ""
        for _, (epoch, *cells) in block.vectors:
            numbers = zip(COMPONENTS, cells, strict=False)
            data += f"\n<stateVector><EPOCH>{epoch}</EPOCH>"
            data += "".join(f"<{name}>{cell}</{name}>" for name, cell in numbers) + "</stateVector>"
        for _, epoch, frame, cells in block.matrices:
            numbers = zip(oem_xml.TRIANGLE, cells, strict=True)
            data += f"<covarianceMatrix><EPOCH>{epoch}</EPOCH><COV_REF_FRAME>{frame}</COV_REF_FRAME>"
            data += "".join(f"<{name}>{cell}</{name}>" for name, cell in numbers) + "</covarianceMatrix>"
        parts.append(f"<segment><metadata>{meta}</metadata><data>{data}</data></segment>")
    return f'<?xml version="1.0"?>\n<oem id="CCSDS_OEM_VERS"><body>{"".join(parts)}</body></oem>'


def test_both_notations_say_the_same():
    for one, other in zip(read(TEXT), oem_xml.blocks_of(as_xml(TEXT), "a.xml"), strict=True):
        same = ephemeris(other)
        assert one[:6] == same[:6]
        assert np.array_equal(one.states, same.states)
        assert np.array_equal(one.times, same.times)
        for a, b in zip(one.covariances, same.covariances, strict=True):
            assert (a.time, a.frame) == (b.time, b.frame)
            assert np.array_equal(a.matrix, b.matrix)


def test_a_message_is_a_source_of_trajectories(tmp_path):
    files = Files("orbit", str(HERE))
    assert files.space.components == ("x", "y", "z", "px", "py", "pz")
    assert files.space.frame == "EME2000, EARTH, UTC, from 2016-12-31T23:59:00.000"
    assert files.space.units.velocity == "km/s"
    states, times, *_ = files.read()
    assert times[1, :2].tolist() == [3661.0, 3721.0]
    assert states[0, 0].tolist() == [7000.0, 0.0, 0.0, 0.0, 7.5, 0.25]
    (tmp_path / "later.oem").write_text(TEXT.replace("T23:59", "T23:58"))
    both = Files("orbit", [str(HERE), str(tmp_path / "later.oem")], mass=2.0)
    assert both.read().times[:, 0].tolist() == [60.0, 3721.0, 0.0, 3721.0]
    assert both.read().states[0, 0].tolist() == [7000.0, 0.0, 0.0, 0.0, 15.0, 0.5]
    for old, new in {"EME2000": "ITRF", "EARTH": "MARS", "= UTC": "= TAI"}.items():
        (tmp_path / "other.oem").write_text(TEXT.replace(old, new))
        with pytest.raises(UserError, match=r"other.oem: expected frame EME2000, EARTH, UTC.* received .*"):
            Files("orbit", [str(HERE), str(tmp_path / "other.oem")])


def test_times_of_several_files_count_from_the_first_epoch_also_across_that_of_2000(tmp_path):
    for k, day in enumerate((-1, 0, 1)):
        states = np.full((3, 6), float(k))
        given = Ephemeris("1", "SAT", "EARTH", "EME2000", "TAI", day * 86400 * SECOND, np.arange(3.0), states)
        write_oem(tmp_path / f"{k}.oem", [given])
    files = Files("orbit", [str(tmp_path / f"{k}.oem") for k in (1, 2, 0)])
    assert files.read().times[:, 0].tolist() == [86400.0, 172800.0, 0.0]
    assert files.space.frame.endswith("TAI, from 1999-12-31T00:00:00.000")


def test_a_frame_that_rotates_is_warned_of(tmp_path, caplog):
    Files("orbit", str(HERE)).check()
    assert "rotates" not in caplog.text
    (tmp_path / "a.oem").write_text(TEXT.replace("EME2000", "ITRF2000"))
    Files("orbit", str(tmp_path / "a.oem"), unsound=True).check()
    assert "frame ITRF2000, EARTH, UTC, from 2016-12-31T23:59:00.000 rotates" in caplog.text


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("CCSDS_OEM_VERS = 2.0\n", "", "row 2: expected CCSDS_OEM_VERS first"),
        ("7.48", "7,48", "row 19, column Y_DOT: expected a number with a decimal point; received '7,48'"),
        ("7.48", "nan", "row 19, column Y_DOT: expected a number; received none"),
        ("-1.0 7.44", "-1.0", "row 20: expected an epoch, three positions and three velocities; received 6"),
        ("2017-001T", "2017-366T", "row 20, column EPOCH: expected a calendar date"),
        ("2017-001T", "2017-1T", "row 20, column EPOCH: expected an epoch such as"),
        ("2017-001T00:01", "2016-12-31T23:59", "row 20, column EPOCH: expected a time of 1994-081A after"),
        ("2017-001T00:01:00.5Z", "2017-01-01T00:00:00", "row 20, column EPOCH: expected each time"),
        ("CENTER_NAME = EARTH\n", "", "row 6, column CENTER_NAME: expected a value in the segment metadata"),
        ("TIME_SYSTEM = UTC", "TIME_SYSTEM", "row 11: expected KEYWORD = value"),
        ("1e-9 6e-8", "1e-9", "row 22, column EPOCH: expected the 21 numbers of the lower triangle"),
        ("EPOCH = 2017", "AT = 2017", "row 22: expected EPOCH or COV_REF_FRAME; received 'AT'"),
        (
            "EPOCH = 2017-01-01T00:00:00\n",
            "",
            "row 22: expected EPOCH or COV_REF_FRAME; received 'COV_REF_FRAME'",
        ),
        (
            "START\nEPOCH = 2017-01-01T00:00:00\nCOV_REF_FRAME = RTN\n",
            "START\n",
            "row 22: expected EPOCH = first in a",
        ),
        ("META_STOP\n2017-01-01T01", "2017-01-01T01", "row 40: expected KEYWORD = value"),
        (TEXT[TEXT.rindex("META_STOP") :], "", "row 39: expected a segment from META_START to its states"),
    ],
)
def test_a_fault_is_named_with_its_line(tmp_path, old, new, expected):
    changed = TEXT.replace(old, new, 1)
    assert changed != TEXT
    (tmp_path / "a.oem").write_text(changed)
    with pytest.raises(UserError) as caught:
        Files("orbit", str(tmp_path / "a.oem"))
    assert f"a.oem, {expected}" in str(caught.value)


def test_segments_that_disagree_are_refused(tmp_path):
    head, _, tail = TEXT.rpartition("REF_FRAME = EME2000")
    (tmp_path / "a.oem").write_text(f"{head}REF_FRAME = ITRF2000{tail}")
    with pytest.raises(UserError, match="row 32: expected frame EME2000 in each segment; received ITRF2000"):
        Files("orbit", str(tmp_path / "a.oem"))


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("</body>", "", "row 7: expected XML; received mismatched tag"),
        ("<X>", '<X units="m">', "row 3, column X: expected units km; received 'm'"),
        ("<Z>0.0</Z>", "", "row 3, column Z: expected the element; received none"),
        ("<segment>", "<part>", "row 2: expected an orbit ephemeris message <oem>; received one with <part>"),
        ("<oem", '<!DOCTYPE x [<!ENTITY a "b">]><oem', "row 2: expected no custom entities"),
    ],
)
def test_a_fault_of_xml_is_named(old, new, expected):
    with pytest.raises(UserError) as caught:
        oem_xml.blocks_of(as_xml(TEXT).replace(old, new, 1), "a.xml")
    assert expected in str(caught.value)


def test_units_in_xml_are_those_of_the_standard():
    known = {"X": "km", "Y_DOT": "km/s", "Z_DDOT": "km/s**2", "EPOCH": "", "CX_X": "km**2"}
    known |= {"CX_DOT_Y": "km**2/s", "CZ_DOT_Z_DOT": "km**2/s**2"}
    assert {tag: oem_xml.unit_of(tag) for tag in known} == known
    text = as_xml(TEXT).replace("<X_DOT>", '<X_DOT units="KM/S">')
    pushed = text.replace("</Z_DOT>", '</Z_DOT><X_DDOT units="km/s^2">0</X_DDOT>', 1)
    block, _ = oem_xml.blocks_of(pushed, "a.xml")
    assert ephemeris(block).states.tolist() == read(TEXT)[0].states.tolist()
    assert "X_DDOT" in block.unused
    with pytest.raises(UserError, match=r"X_DDOT: expected units km/s\*\*2; received 'km/s'"):
        oem_xml.blocks_of(pushed.replace("km/s^2", "km/s"), "a.xml")


@pytest.mark.parametrize(("end", "kept"), [("00.5", 3), ("00.499", 3), ("00.498999", 2), ("00.501", 3)])
def test_ends_of_a_span_may_be_rounded_to_milliseconds(end, kept):
    text = TEXT.replace("\nSTOP_TIME", f"\nUSEABLE_STOP_TIME = 2017-01-01T00:01:{end}\nSTOP_TIME", 1)
    notes = []
    found = ephemeris(oem.blocks_of(text, "a.oem")[0], notes.append)
    assert len(found.times) == len(found.states) == len(found.rows) == kept
    assert ("1 of 3 states are outside" in str(notes)) is (kept == 2)


@given(st.integers(-(10**9), 10**9), st.integers(0, SECOND - 1), st.booleans())
def test_epochs_are_spelled_as_they_are_read(seconds, fraction, utc):
    moment = seconds * SECOND + fraction
    assert instant(spelled(moment, utc=utc), utc=utc) == moment
    clock = datetime(2000, 1, 1, tzinfo=UTC) + timedelta(seconds=seconds)
    assert spelled(moment, utc=False)[:19] == clock.strftime("%Y-%m-%dT%H:%M:%S")


@given(st.sampled_from(LEAPS), st.integers(-3, 3))
def test_every_second_beside_a_leap_second_has_a_name_of_its_own(day, offset):
    moment = instant(f"{spelled(day * 86400 * SECOND, utc=False)[:10]}T00:00:00", utc=True) + offset * SECOND
    assert instant(spelled(moment, utc=True), utc=True) == moment
    assert (":60." in spelled(moment, utc=True)) == (offset == -1)
    with pytest.raises(ValueError, match="a time of day"):
        instant("2024-02-01T23:59:60", utc=True)


@pytest.mark.parametrize("notation", [oem, oem_xml])
def test_what_a_message_says_of_itself(notation):
    given = read_oem(HERE)[0]
    text = notation.written([given], "ME", "2024-03-01T12:00:00")
    said = dict(re.findall(r"<(\w+)>([^<]*)</" if notation is oem_xml else r"(\w+) = (.*)", text))
    assert (said["ORIGINATOR"], said["CREATION_DATE"]) == ("ME", "2024-03-01T12:00:00")
    assert (said["OBJECT_NAME"], said["OBJECT_ID"]) == ("MOLNIYA", "1994-081A")
    assert (said["START_TIME"], said["STOP_TIME"]) == (given.epoch(0.0), given.epoch(121.5))
    assert said["START_TIME"] == "2016-12-31T23:59:00.000"
    assert said["STOP_TIME"] == "2017-01-01T00:01:00.500"
    assert 'CCSDS_OEM_VERS" version="2.0"' in text or text.startswith("CCSDS_OEM_VERS = 2.0\n")


def test_an_ephemeris_of_ones_own_is_from_no_lines():
    times, states = np.arange(3.0), np.zeros((3, 6))
    assert Ephemeris("1", "", "EARTH", "EME2000", "UTC", 0, times, states).rows.tolist() == []

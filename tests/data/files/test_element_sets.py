"""Lines of element sets: which make a set, and when its samples are."""

from __future__ import annotations

import pytest

from ahnn.data.doctor import examine
from ahnn.data.files import elements
from ahnn.data.files.kinds import kind_of
from ahnn.data.files.reading import FileReading
from ahnn.data.files.table import Place
from ahnn.errors import UserError

ONE = "1 00005U 58002B   00179.78495062  .00000023  00000-0  28098-4 0  475"
TWO = "2 00005  34.2682 348.7242 1859667 331.7664  19.3264 10.8241915741366"


def signed(line):
    """A line with its checksum: digits add up, a minus counts as one, and nothing else counts."""
    digits = [int(sign) for sign in line if sign in "0123456789"]
    return f"{line}{(sum(digits) + line.count('-')) % 10}"


FIRST, SECOND = signed(ONE), signed(TWO)
OTHER = [signed(line.replace("00005", "00006")) for line in (ONE, TWO)]


def sets(*lines):
    faults = []
    found = elements.sets_of("\n".join(lines), "a.tle", faults.append)
    return [one.place.row for one in found], [(fault.place.row, fault.expected) for fault in faults]


def test_the_published_checksums_are_right():
    assert (FIRST[-1], SECOND[-1]) == ("3", "7")
    assert elements.fault_of(FIRST, Place("a.tle", 1)) is None
    for k in range(10):
        assert (elements.fault_of(FIRST[:-1] + str(k), Place("a.tle", 1)) is None) == (k == 3)


def test_names_and_remarks_are_no_lines_of_a_set():
    assert sets("# 1 remark", "VANGUARD 1", FIRST, SECOND, "", "OTHER", *OTHER, "1 2 3") == ([3, 7], [])


def test_the_line_before_a_set_may_name_it():
    """Names have at most 24 characters (26 with the 0 of some catalogues); other lines are no names."""
    names = {
        "VANGUARD 1": "VANGUARD 1",
        "0 VANGUARD 1  ": "VANGUARD 1",
        "# 1 remark": "",
        "": "",
        "V" * 25: "",
    }
    for line, title in {**names, "": ""}.items():
        first, second = elements.sets_of("\n".join([line, FIRST, SECOND, *OTHER]), "a.tle", pytest.fail)
        assert (first.title, second.title) == (title, "")
        assert elements.designator(first) == "1958-002B"
    (alone,) = elements.sets_of(f"{FIRST}\n{SECOND}", "a.tle", pytest.fail)
    assert alone.title == ""
    for field, designator in {
        "14069A  ": "2014-069A",
        "56001ABC": "2056-001ABC",
        "        ": "",
        "14069   ": "",
    }.items():
        one = alone._replace(lines=(f"{FIRST[:9]}{field}{FIRST[17:]}", SECOND))
        assert elements.designator(one) == designator


def test_signs_behind_the_checksum_are_no_part_of_a_set():
    (one,) = elements.sets_of(f"{FIRST}  x\n{SECOND} y 12", "a.tle", pytest.fail)
    assert one.lines == (FIRST, SECOND)


def test_lines_without_their_other_one_are_faults_and_the_next_set_is_read():
    alone = "a line 2 after it"
    assert sets(FIRST, FIRST, SECOND) == ([2], [(1, alone)])
    assert sets(FIRST, SECOND, FIRST) == ([1], [(3, alone)])
    assert sets(SECOND, FIRST, SECOND) == ([2], [(1, "a line 1 for '00005' before it")])
    assert sets(FIRST, OTHER[1], *OTHER) == ([3], [(2, "a line 1 for '00006' before it")])
    assert sets(FIRST, SECOND, SECOND) == ([1], [(3, "a line 1 for '00005' before it")])


def test_a_damaged_line_takes_its_set_with_it_and_no_other():
    assert sets(FIRST[:-1] + "4", SECOND, *OTHER) == ([3], [(1, "3")])
    assert sets(FIRST, SECOND[:-1] + "1", *OTHER) == ([3], [(2, "7")])
    assert sets(FIRST[:-3], SECOND, *OTHER) == ([3], [(1, "69 signs")])


@pytest.mark.parametrize(
    ("step", "duration", "count"), [(60.0, 600.0, 11), (60.0, 659.0, 11), (0.1, 0.3, 4), (5.0, 5.0, 2)]
)
def test_samples_reach_to_the_end_of_the_duration(step, duration, count):
    pytest.importorskip("sgp4")
    found = elements.content(f"{FIRST}\n{SECOND}", "a.tle", step, duration)
    (track,) = found.tracks
    assert track.times.tolist() == pytest.approx([step * k for k in range(count)], rel=1e-12)
    assert track.name == "00005"
    assert set(track.rows) == {1}


def test_sets_of_other_epochs_begin_later():
    pytest.importorskip("sgp4")
    later = signed(ONE.replace("00005", "00006").replace("179.78495062", "181.28495062"))
    text = "\n".join((later, OTHER[1], FIRST, SECOND))
    found = elements.content(text, "a.tle", 60.0, 600.0)
    assert [track.times[0] for track in found.tracks] == [129600.0, 0.0]
    assert found.epoch == elements.epoch(elements.ElementSets(Place("a.tle", 1), (FIRST, SECOND)))


def test_what_decides_that_a_text_holds_element_sets():
    assert kind_of(f"# remark\n\nNAME\n{FIRST}\n{SECOND}".encode(), "a.txt") == "elements"
    assert kind_of(f"{FIRST}\n{SECOND}".encode(), "a.csv") == "elements"
    assert kind_of(f"t,x\n0,1\n{FIRST}".encode(), "a.csv") == "table"
    assert kind_of(b"t,x", "a.tle") == "elements"


@pytest.mark.parametrize(
    ("line", "column", "text", "said"),
    [
        (0, 53, " 1o270-3", "row 1, column drag term: expected a number; received ' 1o270-3'"),
        (0, 62, "4", "row 1, column ephemeris type: expected a number up to 3; received '4'"),
        (0, 18, "24461.50000000", "row 1, column epoch: expected a day of the year"),
        (1, 8, "190.6416", "row 2, column inclination: expected a number up to 180"),
        (1, 8, " 5x.6416", "row 2, column inclination"),
        (1, 17, "247,4627", "row 2, column node"),
        (1, 26, "       ", "row 2, column eccentricity"),
        (1, 26, "00a6703", "row 2, column eccentricity"),
        (1, 34, "400.0000", "row 2, column perigee: expected a number up to 360"),
        (1, 43, "        ", "row 2, column mean anomaly"),
        (1, 52, "-5.72125391", "row 2, column mean motion"),
    ],
)
def test_a_field_that_is_no_number_of_its_kind_is_refused(line, column, text, said):
    """The library reads the like as zero, as infinite, or as another orbit."""
    pytest.importorskip("sgp4")
    lines = [FIRST, SECOND]
    lines[line] = signed(f"{lines[line][:column]}{text}{lines[line][column + len(text) : 68]}")
    with pytest.raises(UserError) as caught:
        elements.content("\n".join(lines), "a.tle", 60.0, 600.0)
    assert f"a.tle, {said}" in str(caught.value)


def test_what_sgp4_does_not_use_is_said():
    pytest.importorskip("sgp4")
    notes = []
    elements.content(f"{FIRST}\n{SECOND}", "a.tle", 60.0, 600.0, note=notes.append)
    assert [one.what for one in notes] == [elements.UNUSED]


@pytest.mark.parametrize(("inclination", "eccentricity"), [("  0.0010", "0003000"), (" 63.4000", "8500000")])
def test_sgp4s_own_velocities_are_no_fault(tmp_path, inclination, eccentricity):
    pytest.importorskip("sgp4")
    motion = " 1.00270000" if eccentricity == "0003000" else " 0.50000000"
    second = f"{SECOND[:8]}{inclination}{SECOND[16:26]}{eccentricity}{SECOND[33:52]}{motion}{SECOND[63:68]}"
    (tmp_path / "a.txt").write_text(f"{FIRST}\n{signed(second)}\n")
    found = examine([tmp_path / "a.txt"], FileReading(step=300.0, duration=259200.0))
    assert [one for one in found.findings if one.level == "fault"] == []


@pytest.mark.parametrize("text", ["24367.50000000", "24000.50000000"])
def test_an_epoch_that_is_none_is_a_fault_of_the_check_too(tmp_path, text):
    pytest.importorskip("sgp4")
    path = tmp_path / "a.tle"
    path.write_text(f"{signed(f'{FIRST[:18]}{text}{FIRST[32:68]}')}\n{SECOND}\n")
    found = examine([path], FileReading(None, 60.0, 600.0))
    assert any("a day of the year" in fault.what for fault in found.faults)


def test_an_orbit_that_decays_is_refused_from_when_it_does():
    api = pytest.importorskip("sgp4.api")
    heavy = signed(f"{FIRST[:53]} 50000-1{FIRST[61:68]}")
    low = signed(f"{SECOND[:26]}0001000{SECOND[33:52]}16.00000000{SECOND[63:68]}")
    satellite = api.Satrec.twoline2rv(heavy, low)
    code, k = next(
        (code, k)
        for k in range(1000)
        if (code := satellite.sgp4(satellite.jdsatepoch, satellite.jdsatepochF + k / 24)[0])
    )
    assert k > 1
    said = rf"can propagate; received after {3600 * k:g} s: {api.SGP4_ERRORS[code]}. Shorten system.duration"
    with pytest.raises(UserError, match=said):
        elements.content(f"{heavy}\n{low}", "a.tle", 3600.0, 3.6e6)


PLACES = {
    "drag term": (0, 54, 61),
    "ephemeris type": (0, 63, 63),
    "inclination": (1, 9, 16),
    "node": (1, 18, 25),
    "eccentricity": (1, 27, 33),
    "perigee": (1, 35, 42),
    "mean anomaly": (1, 44, 51),
    "mean motion": (1, 53, 63),
}
"""Lines and columns of the standard, counted from 1."""


@pytest.mark.parametrize(("name", "place"), PLACES.items(), ids=PLACES)
def test_every_sign_of_a_field_counts_and_none_beside_it(name, place):
    pytest.importorskip("sgp4")
    line, begin, end = place
    for column in range(begin - 1, end):
        lines = [FIRST, SECOND]
        lines[line] = signed(f"{lines[line][:column]}x{lines[line][column + 1 : 68]}")
        with pytest.raises(UserError, match=f"row {line + 1}, column {name}: expected a number"):
            elements.content("\n".join(lines), "a.tle", 60.0, 600.0)

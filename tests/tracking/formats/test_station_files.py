"""Coordinates of stations (SINEX) and Bulletins B, against values worked out by hand and against erfa."""

from __future__ import annotations

import erfa
import numpy as np
import pytest
from made_formats import BULLETIN, REAL, SINEX

from ahnn.data.files import instant
from ahnn.data.files.epochs import leaps
from ahnn.data.files.kinds import kind_of
from ahnn.errors import UserError
from ahnn.tracking.formats.bulletin_b import bulletin_rows, read_bulletins
from ahnn.tracking.formats.sinex import read_sinex, sinex_moment, sinex_stations
from ahnn.tracking.formats.station_catalogue import geodetic, local_axes

YEAR_2010 = instant("2010-01-01", utc=True)


def moment(text):
    return instant(text, utc=True)


def test_a_marker_moves_with_its_velocity_and_its_solution_is_that_of_the_time():
    found = sinex_stations(SINEX, "a.snx")
    first, second = found.solutions["7090"]
    assert (first.start, second.start) == (moment("1983-01-11T16:21:16"), moment("2005-01-01T00:00:01"))
    assert first.position.tolist() == pytest.approx([-2389.0075, 5043.3294, -3078.5242], rel=1e-14)
    found.eccentricities.clear()
    assert found.position("7090", YEAR_2010).tolist() == second.position.tolist()
    years = 10 * 365.25 * 86400
    ten = YEAR_2010 + int(years) * 10**12
    moved = second.position + 1e-2 * np.array([-0.0468389138240797, 0.00839461295243685, 0.0509471988578335])
    assert np.allclose(found.position("7090", ten), moved, rtol=1e-13, atol=0)
    assert np.allclose(found.position("7090", moment("2001-01-01")), first.position, atol=1e-3)


def test_eccentricities_are_up_north_and_east_of_the_marker():
    found = sinex_stations(SINEX, "a.snx")
    marker = found.solutions["7090"][1].at(moment("2016-02-14"))
    away = (found.position("7090", moment("2016-02-14")) - marker) * 1000
    longitude, latitude, _ = erfa.gc2gd(2, marker * 1000)  # 2 is GRS80
    up = [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)]
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    assert away @ up == pytest.approx(3.1827, abs=1e-6)
    assert away @ east == pytest.approx(-565.4650, abs=1e-6)
    assert away @ np.cross(up, east) == pytest.approx(-112.0064, abs=1e-6)
    before = found.position("7090", moment("2014-03-20")) - found.solutions["7090"][1].at(
        moment("2014-03-20")
    )
    assert np.linalg.norm(before) * 1000 == pytest.approx(np.sqrt(3.185**2 + 0.003**2 + 0.011**2), abs=1e-6)


def test_geodetic_coordinates_are_those_of_erfa():
    for place in ([-2389.0, 5043.3, -3078.5], [4641.9, 1393.0, 4133.2], [0.1, 0.2, 6357.0], [6380.0, 0, 0]):
        latitude, longitude, height = geodetic(np.array(place))
        expected = erfa.gc2gd(2, np.array(place) * 1000)
        assert [longitude, latitude, 1000 * height] == pytest.approx(list(expected), rel=1e-9, abs=1e-9)
        axes = local_axes(np.array(place))
        assert np.allclose(axes @ axes.T, np.eye(3), atol=1e-14)


def test_epochs_of_two_and_four_digits():
    place = None
    assert sinex_moment("10:001:00000", place) == YEAR_2010  # type: ignore[arg-type]
    assert sinex_moment("2010:001:00000", place) == YEAR_2010  # type: ignore[arg-type]
    assert sinex_moment("99:365:86399", place) == moment("1999-12-31T23:59:59")  # type: ignore[arg-type]
    assert sinex_moment("00:000:00000", place) is None  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("%=SNX 2.01", "%=SNX 7.01", "row 1: expected %=SNX and version 1 or 2"),
        ("-.238900750000000E+07", "-.2389007x0000000E+07", "column STAX of 7090: expected a number"),
        ("-.238900750000000E+07", "-.138900750000000E+07", "expected a station on the Earth (7090)"),
        (
            "10:001:00000 m    2 -.2389",
            "10:401:00000 m    2 -.2389",
            "expected a valid epoch YY:DDD:SSSSS",
        ),
        ("10:001:00000 m    2 -.2389", "10:001:00000 km   2 -.2389", "expected an epoch, and STAX in m"),
        ("     2 STAY   7090  A    1", "     2 STAX   7090  A    1", "expected each type once per solution"),
        ("     6 VELZ   7090  A    1", "     6 RBIAS  7090  A    1", "column VELZ: expected all three"),
        ("-SOLUTION/EPOCHS\n", "", "expected -SOLUTION/EPOCHS before another block"),
        ("%ENDSNX\n", "", "expected %ENDSNX at the end; received none. The file is cut off"),
        ("UNE   3.1850", "UNX   3.1850", "expected code, point, solution, technique, start, end, UNE or XYZ"),
        ("UNE   3.1850", "UNE   x.1850", "column SITE/ECCENTRICITY: expected a number; received 'x.1850'"),
        ("83:011:58876 05:001:00000", "83:011:58876 01:001:00000 ", None),
        ("83:011:58876 05:001:00000", "83:011:58876 82:001:00000", "expected an end after the start"),
    ],
)
def test_what_is_wrong_in_coordinates_is_refused_by_its_line(old, new, said):
    assert old in SINEX
    text = SINEX.replace(old, new, 1)
    if said is None:
        assert len(sinex_stations(text, "a.snx").solutions["7090"]) == 2
        return
    with pytest.raises(UserError) as caught:
        sinex_stations(text, "a.snx")
    assert str(caught.value).startswith("a.snx")
    assert said in str(caught.value)


def test_stations_and_times_that_are_not_known_are_refused_by_name(tmp_path):
    found = sinex_stations(SINEX, "a.snx")
    with pytest.raises(UserError, match=r"station 7091: expected .*; received none; did you mean '7090'"):
        found.position("7091", YEAR_2010)
    with pytest.raises(UserError, match=r"station 7090: expected a solution for 1980-01-01T00:00:00\.000"):
        found.position("7090", moment("1980-01-01"))
    late = sinex_stations(SINEX.replace(" 7090  A    1 L 14:080", " 7090  A    1 L 19:080"), "a.snx")
    with pytest.raises(UserError, match=r"station 7090: expected an eccentricity for 2016-01-01"):
        late.position("7090", moment("2016-01-01"))
    for name in ("a.snx", "b.snx"):
        (tmp_path / name).write_text(SINEX)
    with pytest.raises(
        UserError, match="expected positions of a station in only one file; received 7090 in two files"
    ):
        read_sinex(tmp_path / "a.snx", tmp_path / "b.snx")
    only = SINEX.partition("+SOLUTION/EPOCHS")[0] + "%ENDSNX\n"
    with pytest.raises(UserError, match="expected one of the blocks SOLUTION/ESTIMATE"):
        sinex_stations(only, "a.snx")


def test_days_of_a_bulletin(tmp_path):
    (tmp_path / "a.txt").write_text(BULLETIN)
    found = read_bulletins(tmp_path / "a.txt")
    assert found.mjd.tolist() == [55471.0, 55472.0, 55473.0, 55474.0]
    assert (found.x[0], found.y[0]) == pytest.approx((0.234008, 0.363573), rel=1e-14)
    assert found.ut1_utc[1] == pytest.approx(-0.0611022, rel=1e-14)
    assert found.pole[0].tolist() == pytest.approx([3.26e-4, -6e-6], rel=1e-14)
    assert found.final.tolist() == [True, True, False, False]


def test_final_values_go_before_preliminary_ones_and_gaps_are_refused(tmp_path):
    later = BULLETIN.replace("233.967", "233.000").replace(" Preliminary extension\n", "")
    for name, text in (("a.txt", BULLETIN), ("b.txt", later)):
        (tmp_path / name).write_text(text)
    for order in (("a.txt", "b.txt"), ("b.txt", "a.txt")):
        found = read_bulletins([tmp_path / name for name in order])
        assert found.x[2] == 0.233
        assert found.final.all()
    far = BULLETIN.replace("2010  10   ", "2010  11   ")
    for day in range(55471, 55475):
        far = far.replace(str(day), str(day + 31))
    (tmp_path / "c.txt").write_text(far)
    with pytest.raises(
        UserError, match=r"expected bulletins for consecutive days: MJD 55475 after MJD 55474"
    ):
        read_bulletins([tmp_path / "a.txt", tmp_path / "c.txt"])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("BULLETIN B", "BULLETIN D", "expected an IERS Bulletin B"),
        ("milliarcsecond", "arcsecond", "expected units mas and ms before the values"),
        (
            "55472  234",
            "55473  234",
            "column MJD: expected the modified Julian date of 2010-10-3; received 55473",
        ),
        ("-61.1022", "-61x1022", "column UT1-UTC: expected a number; received '-61x1022'"),
        ("-61.1022", "-61102.2", "column UT1-UTC: expected a number from -900 to 900"),
        ("2010  10   3", "2010  13   3", "expected year, month and day"),
        ("2010  10   3", "2010  1x   3", "expected the day after the previous line's"),
        (BULLETIN[BULLETIN.index(" 2 - DAILY") :], "", "expected section 1 with daily values, and section 2"),
    ],
)
def test_what_is_wrong_in_a_bulletin_is_refused_by_its_line(old, new, said):
    assert old in BULLETIN
    with pytest.raises(UserError) as caught:
        bulletin_rows(BULLETIN.replace(old, new, 1), "a.txt")
    assert str(caught.value).startswith("a.txt")
    assert said in str(caught.value)


@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
def test_real_stations_are_where_others_have_them():
    folder = REAL / "lageos2"
    found = read_sinex(folder / "SLRF2014_POS+VEL_2030.0_200428.snx", folder / "ecc_une.snx")
    assert (len(found.solutions), len(found.eccentricities)) == (182, 234)
    text = (folder / "od_test_Lageos2.in").read_text()
    said = dict(line.split("=")[:2] for line in text.splitlines() if line.startswith("ground.station"))
    said = {"".join(key.split()): value.strip() for key, value in said.items()}
    when = moment("2016-02-14")
    for k in range(4):
        at = [float(said[f"ground.station.{name}[{k}]"]) for name in ("latitude", "longitude", "altitude")]
        code = said[f"ground.station.name[{k}]"]
        other = erfa.gd2gc(1, np.radians(at[1]), np.radians(at[0]), at[2]) / 1000
        assert np.linalg.norm(found.position(code, when) - other) < 3e-3, code


@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
def test_real_leap_seconds_are_those_that_are_counted_and_their_file_is_refused_by_name():
    path = REAL / "w3b" / "tai-utc.dat"
    lines = [line.split() for line in path.read_text().splitlines() if line.strip()]
    days = [float(line[4]) - 2451544.5 for line in lines]  # Julian dates, from the first day of 2000
    steps = [float(line[6]) for line in lines]
    later = [(day, step) for day, step in zip(days, steps, strict=True) if step > 10]
    for day, step in later:
        assert (leaps(int(day)), leaps(int(day) - 1)) == (step - 10, step - 11)
    assert len(later) >= 24
    with pytest.raises(UserError, match="received leap seconds"):
        kind_of(path.read_bytes(), str(path))


@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
@pytest.mark.parametrize(("folder", "days"), [("w3b", 92), ("lageos2", 91)])
def test_real_bulletins_follow_one_another(folder, days):
    found = read_bulletins(sorted((REAL / folder).glob("*bulletinb*")))
    assert len(found.mjd) == days
    assert np.abs(np.diff(found.ut1_utc)).max() < 3e-3
    assert np.abs(np.diff(found.x)).max() < 5e-3

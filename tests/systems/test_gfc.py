"""Files of gravity fields: what they say is read, and everything else is one error with its row."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from ahnn.errors import UserError
from ahnn.systems import MolniyaGravity
from ahnn.systems.gravity import GravityField, ggm05c, read_gfc
from ahnn.systems.gravity.ggm05c import ROWS

HEAD = """A comment: radius of what follows.
begin_of_head ================================
product_type              gravity_field
modelname                 GGM05C
earth_gravity_constant    0.3986004415E+15
radius                    6378136.3
max_degree                8
errors                    formal
norm                      fully_normalized
tide_system               zero_tide

key    L    M        C                S           sigma C    sigma S
end_of_head ==================================
"""
FIRST = "gfc 0 0 1.0d0 0.0d0 0. 0.\ngfc 1 0 0.0 0.0 0. 0.\ngfc 1 1 0.0 0.0 0. 0.\n"
BODY = FIRST + "".join(f"gfc {n:4d} {m:4d} {c!r} {s!r} 1.0D-12 1.0D-12\n" for n, m, c, s in ROWS)
TEXT = HEAD + BODY
SMALL = HEAD.replace("max_degree                8", "max_degree 2").replace("errors ", "error_s ") + (
    "gfc 0 0 1.0 0.0\ngfc 2 0 -4.8e-4 0.0\ngfc 2 1 0.0 1.0e-9\ngfc 2 2 2.4e-6 -1.4e-6\n"
)


@pytest.fixture
def parsed(tmp_path):
    """Return what is read of a text or of bytes."""

    def read(content, **options) -> GravityField:
        path = tmp_path / "field.gfc"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_gfc(path, **options)

    return read


def same(a: GravityField, b: GravityField) -> bool:
    return a.checksum == b.checksum and (a.name, a.tide) == (b.name, b.tide)


def test_a_file_is_the_field_that_it_was_written_of(parsed):
    assert same(parsed(TEXT), ggm05c())


@pytest.mark.parametrize(
    "changed",
    [
        TEXT.replace("\n", "\r\n"),
        TEXT.replace("\n", "\r"),
        TEXT.replace("begin_of_head ================================", ""),
        TEXT.replace("product_type              gravity_field\n", ""),
        TEXT.replace("norm                      fully_normalized\n", ""),
        TEXT.replace(FIRST, ""),
        TEXT.replace("d0", "E0").replace("D-12", "e-12"),
        TEXT.replace("e-", "D-"),
        TEXT.replace("e-", "d-"),
        TEXT.replace("\ngfc", "\n\n  gfc"),
        HEAD + "".join(reversed(BODY.splitlines(keepends=True))),
        ("Förste\n" + TEXT).encode("latin-1"),
    ],
)
def test_writings_of_the_same_field(parsed, changed):
    assert same(
        parsed(
            changed.replace("A comment: radius of what follows.\n\n", "")
            if isinstance(changed, str)
            else changed
        ),
        ggm05c(),
    )


def test_mass_and_centre_are_those_of_the_file_where_it_gives_them(parsed):
    field = parsed(
        TEXT.replace("gfc 0 0 1.0d0", "gfc 0 0 1.00001d0").replace("gfc 1 1 0.0 0.0", "gfc 1 1 2D-9 3D-9")
    )
    assert (field.cosines[0, 0], field.cosines[1, 1], field.sines[1, 1]) == (1.00001, 2e-9, 3e-9)
    assert parsed(TEXT.replace(FIRST, "")).cosines[:2, :2].tolist() == [[1.0, 0.0], [0.0, 0.0]]


def test_plain_coefficients_are_normalised(parsed):
    rows = []
    for n, m, c, s in ROWS:
        factor = math.sqrt((1 if m == 0 else 2) * (2 * n + 1) * math.factorial(n - m) / math.factorial(n + m))
        rows.append(f"gfc {n} {m} {c * factor!r} {s * factor!r}\n")
    head = HEAD.replace("fully_normalized", "unnormalized").replace("formal", "no")
    field, known = parsed(head + "".join(rows)), ggm05c()
    assert np.allclose(field.cosines, known.cosines, rtol=1e-14, atol=0)
    assert np.allclose(field.sines, known.sines, rtol=1e-14, atol=0)


VARYING = SMALL.replace("gfc 2 0 -4.8e-4 0.0\n", "gfct 2 0 -4.8e-4 0.0 20050101\ntrnd 2 0 1.0e-11 0.0\n") + (
    "acos 2 0 3.0e-11 0.0 1.0\nasin 2 0 5.0e-11 0.0 1.0\n"
)


def test_what_varies_in_time_is_taken_at_an_epoch(parsed):
    then = parsed(VARYING, epoch="2005-01-01")
    assert then.cosines[2, 0] == pytest.approx(-4.8e-4 + 3e-11, rel=1e-15)
    later = parsed(VARYING, epoch="2006-04-02")  # 456 days
    years = 456 / 365.25
    turns = 2 * math.pi * years
    expected = -4.8e-4 + 1e-11 * years + 3e-11 * math.cos(turns) + 5e-11 * math.sin(turns)
    assert later.cosines[2, 0] == pytest.approx(expected, rel=1e-15)
    assert later.cosines[2, 2] == then.cosines[2, 2]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (TEXT.replace("end_of_head", ""), "a header that ends with end_of_head"),
        (TEXT.replace("radius                    6378136.3\n", ""), "radius in the header; received none"),
        (TEXT.replace("earth_gravity_constant", "# "), "earth_gravity_constant in the header; received none"),
        (TEXT.replace("max_degree  ", "max_degre  "), "max_degree in the header; received none"),
        (TEXT.replace("0.3986004415E+15", "0.0"), "row 5: expected earth_gravity_constant > 0, in m and s"),
        (TEXT.replace("6378136.3", "-1"), "row 6: expected radius > 0"),
        (TEXT.replace("6378136.3", "6378 136.3x").replace("6378 ", "nan "), "radius as a finite number"),
        (
            TEXT.replace("fully_normalized", "schmidt"),
            "norm fully_normalized or unnormalized; received schmidt",
        ),
        (TEXT.replace("zero_tide", "no_tide"), "expected tide_system zero_tide or .*; received no_tide"),
        (TEXT.replace("gravity_field", "topography"), "product_type gravity_field; received topography"),
        (TEXT.replace("modelname  ", "radius 5\nmodelname  "), "one radius with a value"),
        (BODY, "end_of_head"),
        (TEXT[:-200], "row 56: expected order m as a whole number; received nothing"),
        (TEXT[:-180], "row 56: expected 7 columns, as in the first gfc row; received"),
        (
            "\n".join(TEXT.splitlines()[:-3]),
            r"all coefficients to max_degree 8; received none for n, m = \(8, 6\)",
        ),
        (TEXT + "gfc 8 8 0.0 0.0 0.0 0.0\n", r"each coefficient once; received n, m = \(8, 8\) twice"),
        (TEXT + "gfc 9 0 0.0 0.0 0.0 0.0\n", r"order <= degree <= max_degree 8; received n, m = \(9, 0\)"),
        (TEXT + "gfc 7 8 0.0 0.0 0.0 0.0\n", "order <= degree"),
        (TEXT + "gfx 8 8 0.0 0.0 0.0 0.0\n", "row 59: .* one of gfc, gfct, .*; received gfx"),
        (TEXT.replace("gfc    8    8", "gfc    8    8.0"), "order m as a whole number; received 8.0"),
        (TEXT.replace("9.4799107163032e-09", "1_0"), "C as a finite number; received 1_0"),
        (TEXT.replace("9.4799107163032e-09", "inf"), "C as a finite number; received inf"),
        (VARYING, "an epoch, YYYY-MM-DD, for coefficients that vary in time; received none"),
        (
            VARYING.replace("gfct 2 0 -4.8e-4 0.0 20050101", "gfc 2 0 -4.8e-4 0.0"),
            "a gfct row for the coefficient",
        ),
        (SMALL.replace("norm   ", "format icgem2.0\nnorm   ").replace("gfc 2 0", "gfct 2 0"), "static field"),
        (SMALL.replace("fully_normalized", "unnormalized").replace("degree 2", "degree 81"), "degree 81"),
        ("", "end_of_head"),
    ],
)
def test_a_mistake_is_one_message(parsed, text, said):
    with pytest.raises(UserError, match=said) as refused:
        parsed(text)
    assert "\n" not in str(refused.value)
    assert "field.gfc" in str(refused.value)


MOON = SMALL.replace("0.3986004415E+15", "0.4902800222E+13").replace("6378136.3", "1738000")
UNPHYSICAL = {
    "no mass": (TEXT.replace("gfc 0 0 1.0d0", "gfc 0 0 0.0d0"), r"C = 1 for n, m = \(0, 0\), .*; received 0"),
    "five masses": (
        TEXT.replace("gfc 0 0 1.0d0", "gfc 0 0 5.0d0"),
        r"C = 1 for n, m = \(0, 0\), .*; received 5",
    ),
    "far off along z": (TEXT.replace("gfc 1 0 0.0", "gfc 1 0 5.0"), "centre of mass, .*up to 5"),
    "off along x": (TEXT.replace("gfc 1 1 0.0", "gfc 1 1 -1e-3"), "centre of mass, .*up to 0.001"),
    "off along y": (TEXT.replace("gfc 1 1 0.0 0.0", "gfc 1 1 0.0 1e-5"), "centre of mass, .*up to 1e-05"),
    "a flattening of 5": (SMALL.replace("-4.8e-4", "5.0"), "at most 1; received one of 5"),
    "radius in km": (TEXT.replace("6378136.3", "6378.1363"), r"row 6: expected radius in m .*in metres"),
    "constant in km": (TEXT.replace("0.3986004415E+15", "398600.4415"), "row 6: expected radius in m"),
    "both in km": (
        TEXT.replace("0.3986004415E+15", "398600.4415").replace("6378136.3", "6378.1363"),
        r"5\.\d+e\+03 kg/m\^3",
    ),
}


@pytest.mark.parametrize("case", UNPHYSICAL)
def test_what_no_body_has_is_refused_with_the_remedy(parsed, case):
    text, said = UNPHYSICAL[case]
    with pytest.raises(UserError, match=said):
        parsed(text)


def test_other_bodies_are_read_and_small_ones_reported(parsed, caplog):
    assert parsed(MOON).radius == 1738.0
    assert caplog.messages == []
    eros = parsed(SMALL.replace("0.3986004415E+15", "4.463E+05").replace("6378136.3", "16000"))
    assert eros.radius == 16.0
    assert "a radius of 16000 m" in caplog.text


@pytest.mark.parametrize(
    ("epoch", "text", "said"),
    [
        ("soon", VARYING, "an epoch YYYY-MM-DD; received soon"),
        ("2010-01-01", VARYING.replace("20050101", "20051301"), "the reference epoch YYYYMMDD"),
        ("2010-01-01", VARYING.replace("0.0 1.0\nasin", "0.0 0.0\nasin"), "a period > 0"),
    ],
)
def test_a_mistake_in_time_is_one_message(parsed, epoch, text, said):
    with pytest.raises(UserError, match=said):
        parsed(text, epoch=epoch)


@pytest.mark.parametrize("place", ["/dev/zero", "/", "no\0where", "", "~nobody-of-this-name/x.gfc"])
def test_what_is_no_file_is_refused(place):
    with pytest.raises(UserError, match="expected a file with a gravity field; received"):
        read_gfc(place)


def test_a_file_is_a_system_with_its_own_tide(tmp_path):
    path = tmp_path / "mine.gfc"
    path.write_text(TEXT.replace("zero_tide", "tide_free"))
    options = {"name": "mine", "dt": 60.0, "steps": 10, "gravity": str(path)}
    with pytest.raises(UserError, match=r"tide: expected tide_free, as .*; received zero_tide"):
        MolniyaGravity(**options)
    q = torch.tensor([7000.0, 100.0, 0.0], dtype=torch.float64)
    system = MolniyaGravity(**options, tide="tide_free")
    assert torch.equal(system.force(q), ggm05c().cut(8, 0).attraction(q))


BYTES = TEXT.encode()
SPOILS = st.lists(
    st.one_of(
        st.tuples(st.just("cut"), st.integers(0, len(BYTES)), st.just(b"")),
        st.tuples(st.just("put"), st.integers(0, len(BYTES)), st.binary(max_size=8)),
        st.tuples(st.just("over"), st.integers(0, len(BYTES)), st.binary(min_size=1, max_size=8)),
        st.tuples(
            st.just("put"),
            st.integers(0, len(BYTES)),
            st.sampled_from(
                [
                    b"\x00",
                    b"\r",
                    b"\n",
                    b" ",
                    b"-",
                    b"D",
                    b"1e999",
                    b"nan",
                    b"999999",
                    b"gfct ",
                    b"end_of_head\n",
                ]
            ),
        ),
        st.tuples(st.just("drop"), st.integers(0, TEXT.count("\n")), st.just(b"")),
        st.tuples(st.just("twice"), st.integers(0, TEXT.count("\n")), st.just(b"")),
    ),
    min_size=1,
    max_size=4,
)


def spoiled(content: bytes, spoils) -> bytes:
    for kind, place, more in spoils:
        lines = content.splitlines(keepends=True)
        if kind == "cut":
            content = content[:place]
        elif kind == "put":
            content = content[:place] + more + content[place:]
        elif kind == "over":
            content = content[:place] + more + content[place + len(more) :]
        elif kind == "drop":
            content = b"".join(lines[:place] + lines[place + 1 :])
        else:
            content = b"".join(lines[:place] + lines[place : place + 1] * 2 + lines[place + 1 :])
    return content


@settings(max_examples=1000)
@given(SPOILS)
def test_a_spoiled_file_is_read_or_refused(tmp_path_factory, spoils):
    path = tmp_path_factory.getbasetemp() / "spoiled.gfc"
    path.write_bytes(spoiled(BYTES, spoils))
    try:
        field = read_gfc(path)
    except UserError as refused:
        said = str(refused)
    else:
        said = (
            "spoiled.gfc" if field.mu > 0 and np.isfinite([field.cosines, field.sines]).all() else "nonsense"
        )
    assert "spoiled.gfc" in said
    assert len(said) < 500

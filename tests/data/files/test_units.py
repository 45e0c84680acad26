"""Units in column names: what they stand for, and which are refused."""

from __future__ import annotations

import math

import pytest
from scipy import constants

from ahnn.data.files.table import Header
from ahnn.data.files.unit_suffixes import with_suffixes
from ahnn.data.files.units import BASE, unit


@pytest.mark.parametrize(
    ("text", "size", "dimension"),
    [
        ("km", 1e3, (0, 1, 0, 0)),
        ("km/s", 1e3, (0, 1, -1, 0)),
        ("m s^-1", 1.0, (0, 1, -1, 0)),
        ("m·s⁻¹", 1.0, (0, 1, -1, 0)),
        ("kg km/s", 1e3, (1, 1, -1, 0)),
        ("kg*m**2/s", 1.0, (1, 2, -1, 0)),
        ("g cm²/min", 1e-3 * 1e-4 / 60, (1, 2, -1, 0)),
        ("deg/h", math.pi / 180 / 3600, (0, 0, -1, 1)),
        ("1/s", 1.0, (0, 0, -1, 0)),
        ("m/s/s", 1.0, (0, 1, -2, 0)),
        ("1", 1.0, (0, 0, 0, 0)),
        ("", 1.0, (0, 0, 0, 0)),
    ],
)
def test_what_a_unit_stands_for(text, size, dimension):
    found = unit(text)
    assert found.size == pytest.approx(size, rel=1e-15)
    assert found.dimension == dimension


def test_each_name_has_the_size_that_scipy_gives_it():
    for dimension, sizes in (
        ((1, 0, 0, 0), {"kg": 1.0, "g": constants.gram, "t": constants.metric_ton}),
        ((0, 1, 0, 0), {"m": 1.0, "km": constants.kilo, "cm": constants.centi, "mm": constants.milli}),
        (
            (0, 1, 0, 0),
            {"um": constants.micron, "nm": constants.nano, "au": constants.au, "AU": constants.au},
        ),
        ((0, 0, 1, 0), {"s": 1.0, "ms": constants.milli, "us": constants.micro, "ns": constants.nano}),
        ((0, 0, 1, 0), {"min": constants.minute, "h": constants.hour}),
        ((0, 0, 1, 0), {"d": constants.day, "day": constants.day}),
        ((0, 0, 0, 1), {"rad": 1.0, "deg": constants.degree, "°": constants.degree}),
    ):
        for name, size in sizes.items():
            assert unit(name).size == pytest.approx(size, rel=1e-12)
            assert unit(name).dimension == dimension
            assert unit(f"{name}^-2").size == pytest.approx(size**-2, rel=1e-12)
        assert sizes.keys() <= BASE.keys()


@pytest.mark.parametrize("text", ["furlong", "k m", "m^x", "m^1.5", "m+s", "2 m", "KM"])
def test_what_is_no_unit(text):
    with pytest.raises(ValueError, match="a product of powers of kg"):
        unit(text)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ("t_s x_km vx_km_s", "t [s]; x [km]; vx [km/s]"),
        ("Time_min Y_m v_y_m_s sd_Y_m", "Time [min]; Y [m]; v_y [m/s]; sd_Y [m]"),
        ("t_h theta_deg omega_deg_s", "t [h]; theta [deg]; omega [deg/s]"),
        ("t_d q1_mm v1_mm_s x_dot_m_h", "t [d]; q1 [mm]; v1 [mm/s]; x_dot [m/h]"),
        ("t_km x_s vx_km x_m2 x_kg", "t_km; x_s; vx_km; x_m2; x_kg"),  # of other dimensions
        ("mast_m u_m x_east", "mast_m; u_m; x_east"),  # of other names
        ("t x x_km", "t; x; x_km"),  # x is there
    ],
)
def test_units_may_end_the_usual_names(names, expected):
    given = names.split()
    found = with_suffixes(Header(tuple(given), (None,) * len(given)))
    written = [f"{name} [{own}]" if own else name for name, own in zip(*found, strict=True)]
    assert "; ".join(written) == expected


def test_units_in_brackets_come_before_those_in_names():
    assert with_suffixes(Header(("t_s", "x_km"), ("min", None))) == Header(("t_s", "x"), ("min", "km"))

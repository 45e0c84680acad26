"""The drag coefficient of a low satellite, of a path that is integrated apart; densities of another table."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from entry import call
from low_satellite import COEFFICIENT, FILE, lines

from ahnn.tracking.accelerations.atmospheres import atmosphere


@pytest.mark.parametrize(
    ("height", "density"),
    [
        (150, 2.076e-9),
        (200, 2.541e-10),
        (300, 1.916e-11),
        (400, 2.803e-12),
        (500, 5.215e-13),
        (700, 3.070e-14),
    ],
)
def test_air_is_as_dense_as_in_the_standard_atmosphere_within_a_third(height, density):
    """U.S. Standard Atmosphere 1976, tables of density."""
    assert atmosphere(np.array(float(height)))[0] == pytest.approx(density, rel=0.35)


def test_the_measurements_of_the_page_are_those_of_the_path():
    pytest.importorskip("erfa")
    pytest.importorskip("de421")
    pytest.importorskip("astropy_iers_data")
    drawn, kept = (
        [line.split() for line in some] for some in (lines(), FILE.read_text(encoding="utf-8").splitlines())
    )
    assert [row[:3] for row in drawn] == [row[:3] for row in kept]
    numbers = [np.array([float(x) for row in rows for x in row[3:]]) for rows in (drawn, kept)]
    assert numbers[0] == pytest.approx(numbers[1], abs=2e-3)  # of ranges, a fifth of their noise


@pytest.mark.slow
def test_a_drag_coefficient_is_found(tmp_path):
    pytest.importorskip("erfa")
    pytest.importorskip("de421")
    pytest.importorskip("astropy_iers_data")
    setup = str(FILE.with_name("low_satellite.yaml"))
    assert call("ahnn.orbit", setup, f"out={tmp_path / 'out'}") == 0
    with (tmp_path / "out" / "unknowns.csv").open() as file:
        (drag,) = (row for row in csv.DictReader(file) if row["name"] == "drag")
    assert float(drag["sd"]) < 0.01
    assert abs(float(drag["value"]) - COEFFICIENT) < 3 * float(drag["sd"])

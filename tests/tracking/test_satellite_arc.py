"""Paths against circles in closed form, and their sensitivities against differences."""

from __future__ import annotations

import numpy as np
import pytest

from ahnn.errors import TrainingError
from ahnn.tracking.accelerations.acceleration_of_time import AccelerationOfTime, CubicSplines
from ahnn.tracking.accelerations.contract import known
from ahnn.tracking.satellite_arc import Forces, satellite_arc

MU, A = 398600.4415, 12270.0
RATE = (MU / A**3) ** 0.5
CIRCLE = np.array([A, 0, 0, 0, A * RATE, 0.0])


class PointMass:
    """The attraction of a point."""

    parameters: tuple[str, ...] = ()

    def __call__(self, t, r, v, p):
        del t, v, p
        d = np.linalg.norm(r)
        return known(-MU * r / d**3, MU * (3 * np.outer(r, r) / d**5 - np.eye(3) / d**3))


def test_a_circle_stays_one_both_ways():
    arc = satellite_arc(Forces([PointMass()]), CIRCLE, np.empty(0), 100.0, -40000.0, 90000.0)
    t = np.linspace(-40000, 90000, 777)
    angle = RATE * (t - 100.0)
    exact = A * np.column_stack((np.cos(angle), np.sin(angle), 0 * angle))
    assert np.abs(arc.states(t)[:, :3] - exact).max() < 6e-6  # 6 mm after ten revolutions


def test_sensitivities_are_differences():
    pushed = AccelerationOfTime(CubicSplines(0.0, 20000.0, 4, 1e-8), "inertial")
    forces, p = Forces([PointMass(), pushed]), np.linspace(-1, 1, 21)
    times = np.array([50.0, 9000.0, 20000.0])

    def states(start, weights):
        return satellite_arc(forces, start, weights, 0.0, 0.0, 20000.0).states(times)

    arc = satellite_arc(forces, CIRCLE, p, 0.0, 0.0, 20000.0)
    found = arc.sensitivities(times)
    for k, size in ((0, 1e-2), (4, 1e-5), (6 + 2, 1.0), (6 + 12, 1.0)):
        moved = np.zeros(27)
        moved[k] = size
        slope = (states(CIRCLE + moved[:6], p + moved[6:]) - states(CIRCLE - moved[:6], p - moved[6:])) / (
            2 * size
        )
        assert slope == pytest.approx(found[:, :, k], abs=3e-6 * np.abs(found[:, :, k]).max())


def test_a_path_into_the_centre_is_no_path():
    with pytest.raises(TrainingError, match=r"stopped at .* s: the satellite is inside the Earth"):
        satellite_arc(Forces([PointMass()]), np.array([7000.0, 0, 0, 0, 0, 0]), np.empty(0), 0.0, 0.0, 9000.0)


def test_an_arc_that_takes_too_long_or_begins_nowhere_is_refused():
    forces, nothing = Forces([PointMass()]), np.empty(0)
    arc = satellite_arc(forces, CIRCLE, nothing, 0.0, -3000.0, 20000.0)
    assert arc.evaluations > 100
    same = satellite_arc(forces, CIRCLE, nothing, 0.0, -3000.0, 20000.0, arc.evaluations)
    assert same.evaluations == arc.evaluations
    with pytest.raises(TrainingError, match=r"more than .* evaluations"):
        satellite_arc(forces, CIRCLE, nothing, 0.0, -3000.0, 20000.0, arc.evaluations - 1)
    with pytest.raises(TrainingError, match="finite state"):
        satellite_arc(forces, CIRCLE * np.nan, nothing, 0.0, 0.0, 10.0)

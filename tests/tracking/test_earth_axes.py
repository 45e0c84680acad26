"""Axes of the Earth for stations, months from time zero, beside the complete rotation of ERFA."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch.func import jacrev, vmap

from ahnn.data.files.epochs import instant
from ahnn.measurements import GroundStation
from ahnn.tracking import earth_axes as module

erfa = pytest.importorskip("erfa", reason="the extra `orbit` is needed")

NOON = instant("2024-03-01T12:00:00", utc=True)
TIMES = 86400.0 * np.array([-200.3, 0.0, 0.5, 10.7, 365.25, 900.1])
FROM = "from 2024-03-01T12:00:00.000"
LIKE = torch.zeros(6, dtype=torch.float64)


@pytest.mark.parametrize("frame", ["EME2000", "GCRF", "TEME", "CIRS of 2024-02-01T00:00:00"])
def test_stations_follow_precession_and_nutation(frame):
    station = GroundStation(5.15, -52.65, 0.02, earth_angle=module.earth_axes(f"{frame}, EARTH, UTC, {FROM}"))
    ut1 = module.ut1_of(NOON, TIMES) - 86400 * 8826.5  # since noon
    assert np.abs(ut1 - TIMES).max() < 1.0  # no leap second in these days
    tt, ut1 = (2460371.0, (TIMES + 69.184) / 86400), (2460371.0, ut1 / 86400)
    pole = module.pole_of(NOON, TIMES).numpy().T
    assert 2e-7 < np.abs(pole).max() < 3e-6
    expected = erfa.c2t06a(*tt, *ut1, *pole)
    if frame == "EME2000":
        expected = expected @ erfa.bp00(2460371.0, 0.0)[0].T
    if frame.startswith("CIRS of"):
        expected = expected @ erfa.c2i06a(2460341.5, 69.184 / 86400).T
    if frame == "TEME":
        expected = erfa.pom00(*pole, 0.0) @ erfa.rz(erfa.gmst82(*ut1), np.eye(3))
    site = erfa.gd2gc(1, *np.radians([-52.65, 5.15]), 20.0) / 1e3
    phi, lam = np.radians([5.15, -52.65])
    east = np.array([-math.sin(lam), math.cos(lam), 0.0])
    up = np.array([math.cos(phi) * math.cos(lam), math.cos(phi) * math.sin(lam), math.sin(phi)])
    for k, t in enumerate(TIMES):
        found, axes, drift = (one.numpy() for one in station._frame(LIKE, t))
        assert np.linalg.norm(found - expected[k].T @ site) < 5e-4  # km
        assert np.abs(axes[:, [0, 2]] - expected[k].T @ np.column_stack((east, up))).max() < 1e-7
        before, after = (station._frame(LIKE, t + dt)[0].numpy() for dt in (-10.0, 10.0))
        assert np.abs((after - before) / 20 - drift).max() < 1e-6


def test_axes_of_one_time_and_of_many_are_the_same():
    axes = module.daily_axes("GCRF", NOON)
    station = GroundStation(5.15, -52.65, range_rate=True, earth_angle=axes)
    x = torch.tensor([9000.0, -3000.0, 2000.0, 1.0, 6.0, 2.0], dtype=torch.float64).repeat(len(TIMES), 1)
    times = torch.from_numpy(TIMES)
    one_by_one = torch.stack([station(one, float(t)) for one, t in zip(x, TIMES, strict=True)])
    assert torch.allclose(station(x, times), one_by_one, rtol=1e-13, atol=1e-13)
    slopes = vmap(jacrev(station))(x, times)
    assert torch.allclose(slopes[3], jacrev(station)(x[3], float(TIMES[3])), rtol=1e-12, atol=1e-14)
    assert station(x[:1], torch.tensor([torch.nan], dtype=torch.float64)).isnan().all()
    assert station(x[0], math.nan).isnan().all()
    beyond = axes.at(1e12, LIKE)
    assert torch.equal(beyond, axes.at(torch.tensor(1e12), LIKE))
    assert torch.allclose(beyond, axes.matrices[-1], rtol=1e-15)

"""A satellite that three stations see, its measurements drawn: what a fit should find again is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from earth import EPOCH, bodies, rotation

from ahnn.systems.gravity import eigen6s
from ahnn.tracking.accelerations.acceleration_of_time import AccelerationOfTime, CubicSplines
from ahnn.tracking.accelerations.earth_gravity import EarthGravity
from ahnn.tracking.orbit_fit import OrbitProblem
from ahnn.tracking.satellite_arc import Forces, satellite_arc
from ahnn.tracking.tracking_data import KINDS, TrackingData
from ahnn.tracking.tracking_model import Corrections, TrackingModel
from ahnn.tracking.tracking_station import geodetic_station
from ahnn.tracking.unknowns import START, SmoothBlock, Smoothness, Unknowns

STATIONS = (
    geodetic_station("south", -35.0, 149.0, 0.8),
    geodetic_station("east", 21.0, -156.0, 3.0),
    geodetic_station("north", 41.0, 17.0, 0.5),
)
TRUE = np.array([7526.99, -9646.31, 1464.11, 3.033, 1.715, -4.447])
NOISE = np.array([0.01, 2e-4, 2e-4, np.nan, np.nan, np.nan])
HOURS = 5


def data(event="receive", count=200, seed=3):
    """Times and stations; values follow."""
    rng = np.random.default_rng(seed)
    times = np.sort(rng.uniform(0, 3600 * HOURS, count))
    nothing = np.full((count, 6), np.nan)
    station = rng.integers(0, 3, count)
    names = tuple(one.name for one in STATIONS)
    light = np.full(count, 0.532)
    return TrackingData("", EPOCH, times, nothing, names, station, event, nothing[:, :3], light, nothing)


def model(event="receive", **corrections):
    return TrackingModel(data(event), STATIONS, Corrections(**corrections), rotation(), bodies())


def gravity():
    return EarthGravity(eigen6s().cut(2, 0), rotation())


def learned(pieces=6):
    return AccelerationOfTime(CubicSplines(0.0, 3600.0 * HOURS, pieces, 1e-9), "orbital")


def problem(*, push=0.0, bias=0.0, wild=0, with_learned=False, kinds=3, start=TRUE, **options):
    """Return a problem whose measurements have noise, a push along the track, biases, outliers."""
    made = model()
    term = learned()
    truth = np.zeros(len(term.parameters))
    truth[term.basis.size : 2 * term.basis.size] = push * np.sin(term.basis.centres / 4000.0)
    arc = satellite_arc(Forces([gravity(), term], 450.0), TRUE, truth, 0.0, -1.0, 3600.0 * HOURS + 2)
    values, rng = made(arc).values, np.random.default_rng(5)
    values = values + NOISE * rng.standard_normal(values.shape)
    values[:, kinds:] = np.nan
    values[:, 0] += bias
    values[:wild, 0] += 1.0
    made.data = replace(made.data, values=values)
    forces = Forces([gravity(), *([term] if with_learned else [])], 450.0)
    count = len(forces.parameters)
    pairs = tuple((s, 0) for s in range(3)) if bias else ()
    names = (*START, *forces.parameters, *(f"bias {s}" for s, _ in pairs))
    unknowns = Unknowns(
        names,
        np.concatenate((start, np.zeros(count + len(pairs)))),
        np.full(len(names), np.inf),
        count,
        pairs,
        (SmoothBlock(6, term.basis),) if with_learned else (),
    )
    noise = np.tile(NOISE, (3, 1))
    used = np.ones(len(values), dtype=bool)
    smooth = Smoothness(10.0, 9000.0) if with_learned else None
    options = {"robust": False, "noise_known": True, **options}
    assert noise.shape == (3, len(KINDS))
    return OrbitProblem(forces, made, unknowns, noise, used, 0.0, smooth=smooth, **options), truth

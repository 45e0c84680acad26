"""Several bodies that coast, and readings of them as a table."""

from __future__ import annotations

import csv
import io

import numpy as np
from following import MEAN, P0, SENSORS, SPACE, STEP, Q, coast, readings

from ahnn.assimilation import Catalogue, ReadingTable
from ahnn.assimilation.catalogue_rows import CatalogueRows
from ahnn.assimilation.catalogue_session import CatalogueSession
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.parquet_stream import ParquetRows
from ahnn.estimation import Gate, initial_belief
from ahnn_plugins.ukf import UnscentedKalmanFilter, online_process

NAMES = [f"body {k}" for k in range(7)]
SHARED = [*dict.fromkeys(name for one in SENSORS.values() for name in one.columns)]


def starts(count):
    """Beliefs about bodies that differ."""
    offsets = np.arange(count)[:, None] * np.array([0.05, 0.01])
    return initial_belief(np.array(MEAN) + offsets, P0)


def fleet(names=NAMES, *, gate=None, flow=coast, **options):
    """A catalogue of bodies; None for one that meets them one by one."""
    process = online_process(UnscentedKalmanFilter(gate=gate), flow, STEP, Q)
    start = starts(1 if names is None else len(names))
    return Catalogue(process, SENSORS, start, names, **options)


def table(pairs):
    """A table of pairs of a name and a reading."""
    sensors, wide = [*SENSORS], np.full((2, len(pairs), len(SHARED)), np.nan)
    for k, (_, reading) in enumerate(pairs):
        places = [SHARED.index(name) for name in SENSORS[reading.sensor].columns] if reading.sensor else []
        for place, value, sd in zip(
            places, reading.values, reading.deviations or [np.nan] * len(places), strict=True
        ):
            wide[0, k, place], wide[1, k, place] = value, sd
    numbers = [sensors.index(r.sensor) if r.sensor else -1 for _, r in pairs]
    times = np.array([reading.time for _, reading in pairs])
    return ReadingTable([name for name, _ in pairs], times, np.array(numbers), *wide)


def mixed(counts, seed=0):
    """Readings of bodies, so many of each, as they come in turns that are drawn."""
    draw = np.random.default_rng(seed)
    own = {name: readings(count, seed + k) for k, (name, count) in enumerate(zip(NAMES, counts, strict=True))}
    turns = draw.permutation(np.repeat(np.arange(len(counts)), counts))
    left = {name: iter(found) for name, found in own.items()}
    return [(NAMES[k], next(left[NAMES[k]])) for k in turns.tolist()]


PAIRS = mixed((9, 4, 12, 1, 7, 3, 15))


def written(pairs):
    """Readings as a table with a column of objects."""
    rows = ["time [s],name,sensor,q [m],p"]
    for name, reading in pairs:
        values = ["" if v != v else repr(v) for v in (*reading.values, np.nan)[:2]]
        rows.append(",".join([repr(reading.time), name, reading.sensor, *values]))
    return "\n".join(rows) + "\n"


TEXT = written(PAIRS)


def session(text, output, state=None, every=10, kind="csv", names=NAMES, **options):
    """The session of a text, a pipe, or a Parquet file."""
    stream = io.BytesIO(text.encode()) if isinstance(text, str) else text
    lines = stream if isinstance(stream, ParquetRows) else Lines(stream)
    catalogue = fleet(names, **({"gate": Gate(0.9999)} | options))
    rows = CatalogueRows(SPACE.components, SENSORS, kind)
    return CatalogueSession(catalogue, lines, rows, str(output), state, every, objects="name")


def rows_of(path):
    """The rows of a table."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))

"""A body that coasts, a filter that follows it, and streams of positions of it."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import torch

from ahnn.assimilation import Assimilation, Reading, StreamSensor
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.output_rows import Rows
from ahnn.assimilation.session import Session
from ahnn.estimation import Gate, initial_belief
from ahnn.measurements import Position, State
from ahnn.types import Space, Units
from ahnn_plugins.ukf import UnscentedKalmanFilter, online_process

SPACE = Space("cart", ("q", "p"), Units("s", "m", "m/s", "J"), mechanical=False)
MEAN, P0, Q, SD, STEP = [1.0, 0.3], np.diag([0.5, 0.2]), np.diag([1e-3, 4e-3]), 0.1, 0.5
SENSORS = {
    "ruler": StreamSensor.of(Position(1, "m"), SD, SPACE),
    "radar": StreamSensor.of(State(1, ("m", "m/s")), [0.3, 0.05], SPACE),
}


def coast(x, dt):
    return torch.stack((x[:, 0] + dt * x[:, 1], x[:, 1]), dim=-1)


def make(gate=None, mean=MEAN, **options):
    process = online_process(UnscentedKalmanFilter(gate=gate), coast, STEP, Q)
    return Assimilation(process, SENSORS, initial_belief([mean], P0), **options)


def readings(count, seed=0):
    """Readings of both sensors at irregular times, some numbers missing."""
    draw = np.random.default_rng(seed)
    times = np.cumsum(draw.uniform(0.01, 1.3, count))
    found = []
    for k, time in enumerate(times.tolist()):
        name = "radar" if k % 3 == 2 else "ruler"
        exact = np.array([1.2 + 0.25 * time, 0.25][: len(SENSORS[name].columns)])
        values = exact + draw.normal(size=len(exact)) * 0.05
        if k % 7 == 5:
            values[0] = np.nan
        found.append(Reading(time, tuple(values.tolist()), name))
    return found


def written(found):
    """Readings as a table."""
    head = "time [s],sensor,q [m],p"
    rows = [
        ",".join([repr(r.time), r.sensor, *("" if v != v else repr(v) for v in (*r.values, np.nan)[:2])])
        for r in found
    ]
    return "\n".join([head, *rows]) + "\n"


def session(text, output: Path, state: Path | None = None, every=5, kind="csv", **options):
    stream = io.BytesIO(text.encode()) if isinstance(text, str) else text
    filtering = make(**({"gate": Gate(0.9999)} | options))
    rows = Rows(SPACE.components, SENSORS, kind)
    return Session(filtering, Lines(stream), rows, str(output), state, every)

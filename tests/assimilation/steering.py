"""A cart that two forces push, in closed form; a filter that follows it; commands, and what they do."""

from __future__ import annotations

import io
import math

import numpy as np
import torch
from filterpy.kalman import KalmanFilter
from following import MEAN, P0, SENSORS, SPACE, STEP, Q, readings

from ahnn.assimilation import Assimilation, Reading
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.output_rows import Rows
from ahnn.assimilation.session import Session
from ahnn.clock import split
from ahnn.estimation import initial_belief
from ahnn_plugins.ukf import UnscentedKalmanFilter, online_process

GAINS = np.array([1.5, -0.7])
"""Acceleration by each of the two controls."""
NAMES = ("u", "brake")


class Pushed:
    """q'' = GAINS u(t) for u that moves linearly, of extended states."""

    clock = 3

    def __call__(self, z, dt):
        """The states after dt."""
        q, c, p, r = split(z, 3)
        gains = torch.from_numpy(GAINS)
        a, jerk = ((part[:, 1:] @ gains)[:, None] for part in (c, r))
        after = q + dt * p + dt**2 / 2 * a + dt**3 / 6 * jerk
        return torch.cat((after, c + dt * r, p + dt * a + dt**2 / 2 * jerk, r), dim=-1)


def steered_filter(estimator=None, error=None, sensors=SENSORS, **options):
    process = online_process(estimator or UnscentedKalmanFilter(), Pushed(), STEP, Q, error)
    return Assimilation(process, sensors, initial_belief([MEAN], P0), **options)


def commands(count, seed=0):
    """Readings among which some bring one control or both, and some nothing else."""
    draw = np.random.default_rng(seed + 100)
    found = [Reading(0.0, controls=(0.4, -0.2))]
    for k, reading in enumerate(readings(count, seed)):
        both = tuple(draw.normal(size=2).tolist())
        given = (both, (both[0], None), (None, both[1]), ())[k % 4]
        found.append(reading._replace(controls=given if k % 5 else ()))
        if k % 3 == 0:
            found.append(Reading(reading.time + 0.003, controls=both))
    return sorted(found, key=lambda one: one.time)


def changes(found):
    """Times at which controls change, and the controls from each on."""
    times, held, values = [], (math.nan, math.nan), []
    for one in (one for one in found if one.controls):
        held = tuple(old if u is None else u for old, u in zip(held, one.controls, strict=True))
        if times and times[-1] == one.time:
            values[-1] = held
        else:
            times.append(one.time)
            values.append(held)
    return times, values


def kalman(found, start=0.0):
    """Mean and covariance by filterpy's Kalman filter with inputs, which steps to each reading or command."""
    one, held, now = KalmanFilter(2, 2, 2), np.zeros(2), start
    one.x, one.P = np.array(MEAN), P0.copy()
    for reading in found:
        gap = reading.time - now
        count = max(1, math.ceil(gap / STEP - 1e-9)) if gap > 0.0 else 0
        for _ in range(count):
            h = gap / count
            push = np.outer([h**2 / 2, h], GAINS)
            one.predict(u=held, B=push, F=np.array([[1.0, h], [0.0, 1.0]]), Q=Q * h / STEP)
        now = reading.time
        there = ~np.isnan(reading.values)
        if there.any():
            c = np.eye(2)[: len(there)][there]
            r = np.diag(np.square(SENSORS[reading.sensor].deviations)[there])
            one.update(np.array(reading.values)[there], R=r, H=c)
        if reading.controls:
            held = np.array([old if u is None else u for old, u in zip(held, reading.controls, strict=True)])
    return one.x, one.P


def written_commands(found, names=NAMES):
    """Readings and commands as a table."""

    def cell(value):
        return "" if value is None or value != value else repr(value)

    rows = [f"time,sensor,q,p,{','.join(names)}"]
    for one in found:
        values, controls = (*one.values, math.nan, math.nan)[:2], one.controls or (None,) * len(names)
        rows.append(",".join([repr(one.time), one.sensor, *map(cell, (*values, *controls))]))
    return "\n".join(rows) + "\n"


def steered_session(text, output, state=None, every=5, kind="csv", names=NAMES, **options):
    stream = io.BytesIO(text.encode()) if isinstance(text, str) else text
    rows = Rows(SPACE.components, SENSORS, kind)
    return Session(steered_filter(**options), Lines(stream), rows, str(output), state, every, controls=names)

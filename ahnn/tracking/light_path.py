"""Light-time solution of the two-way path between a station and a satellite."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.tracking.accelerations.relativity import LIGHT
from ahnn.tracking.tracking_data import Event

Array = NDArray[np.float64]
Motion = Callable[[Array], Array]
"""Times (T,) -> positions (T, 3) in GCRF, km."""
ROUNDS = 4
"""Number of fixed-point iterations; each reduces the error by the ratio of speed to light speed, 1e-5."""


class LightPath(NamedTuple):
    """Times and vectors of a signal path.

    Attributes:
        bounce: time at the satellite, (T,).
        transmit, receive: times at the station, (T,).
        up: vector from the transmitting station to the satellite, (T, 3) km.
        down: vector from the receiving station to the satellite, (T, 3) km.
        site: position of the receiving station, (T, 3) km.
    """

    bounce: Array
    transmit: Array
    receive: Array
    up: Array
    down: Array
    site: Array


def light_path(satellite: Motion, site: Motion, times: Array, event: Event) -> LightPath:
    """Return the path of signals, given the times of an event, (T,)."""
    known = site(times)
    if event == "bounce":
        bounce, place = times, satellite(times)
    else:
        sign = 1.0 if event == "transmit" else -1.0
        bounce = times
        for _ in range(ROUNDS):
            bounce = times + sign * np.linalg.norm(satellite(bounce) - known, axis=1) / LIGHT
        place = satellite(bounce)
    transmit, first = _at_station(site, bounce, place, -1.0)
    receive, last = _at_station(site, bounce, place, 1.0)
    if event == "transmit":
        transmit, first = times, known
    elif event == "receive":
        receive, last = times, known
    return LightPath(bounce, transmit, receive, place - first, place - last, last)


def _at_station(site: Motion, bounce: Array, place: Array, sign: float) -> tuple[Array, Array]:
    """Return time and position at the station after (for sign -1 before) the bounce at the satellite."""
    time, where = bounce, site(bounce)
    for _ in range(ROUNDS):
        time = bounce + sign * np.linalg.norm(place - where, axis=1) / LIGHT
        where = site(time)
    return time, where

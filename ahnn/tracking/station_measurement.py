"""Measurement model of a station for filters: predicted measurements from the state at a reading's time.

Light reaches the satellite up to a second before or after the time tag of a reading. Over that time the state
is propagated under the Earth's point-mass attraction, to second order; errors are a few micrometres, and
0.1 mm/s in range rates.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ahnn.measurements.angles import Differing
from ahnn.measurements.base import Time
from ahnn.tracking.satellite_flow import SIZE
from ahnn.tracking.tracking_data import KINDS, UNITS, Kind
from ahnn.tracking.tracking_model import PredictedTracking, TrackingModel
from ahnn.tracking.tracking_station import EARTH_MU

Array = NDArray[np.float64]


class NearbyStates(NamedTuple):
    """States at one time, one per measurement row, from which states at nearby times follow.

    Attributes:
        time: time of the states.
        at: (B, 6) km and km/s.
    """

    time: float
    at: Array

    def states(self, times: Array) -> Array:
        """Return the states (B, 6) at times (B,), one per state."""
        dt, (r, v) = (times - self.time)[:, None], np.split(self.at, 2, axis=1)
        pull = -EARTH_MU * r / np.linalg.norm(r, axis=1, keepdims=True) ** 3
        return np.concatenate((r + v * dt + 0.5 * pull * dt**2, v + pull * dt), axis=1)


class StationMeasurement(Differing):
    """Measurements of states [position, velocity, ...], shape (..., D), by one station.

    Args:
        model: model of all measurements; it supplies the station's weather and wavelength nearest in time.
        station: index of the station in the model.
        kinds: measured kinds.
        biases: for each kind, the index of the state component that is its bias; None without bias.
        known: known bias of each kind.
    """

    def __init__(
        self,
        model: TrackingModel,
        station: int,
        kinds: tuple[Kind, ...],
        biases: tuple[int | None, ...],
        known: tuple[float, ...] = (),
    ) -> None:
        self.names: tuple[str, ...] = kinds
        self.units = tuple(UNITS[kind] for kind in kinds)
        self.station, self.biases = model.stations[station], biases
        self.known = known or (0.0,) * len(kinds)
        self._model, self._rows = model, np.flatnonzero(model.data.station == station)
        self._kinds = [KINDS.index(kind) for kind in kinds]

    @property
    def about(self) -> dict[str, Any]:
        """Plain values that identify the station; forces and corrections are not included."""
        place = [float(one) for one in self.station.position]
        return {
            "station": self.station.name,
            "position": place,
            "kinds": self.names,
            "biases": [*self.biases, *self.known],
        }

    def __call__(self, x: Tensor, t: Time) -> Tensor:
        """Return the measurements (..., M) of the states x (..., D) at time t."""
        flat = x.detach().numpy().reshape(-1, x.shape[-1])
        values = self._predicted(flat, float(t)).values[:, self._kinds] + self.known
        for k, place in enumerate(self.biases):
            values[:, k] += 0.0 if place is None else flat[:, place]
        return torch.from_numpy(values).reshape(*x.shape[:-1], len(self.names))

    def slope(self, x: Tensor, t: Time) -> Tensor:
        """Return derivatives of the measurements, (B, M, D), with respect to states x (B, D) at time t."""
        states = x.detach().numpy()
        found = self._predicted(states, float(t))
        by = found.by_state[:, self._kinds]
        slopes = np.zeros((*by.shape[:2], x.shape[-1]))
        slopes[..., :SIZE] = by
        slopes[..., 3:SIZE] += (found.bounce - float(t))[:, None, None] * by[..., :3]
        for k, place in enumerate(self.biases):
            if place is not None:
                slopes[:, k, place] = 1.0
        return torch.from_numpy(slopes)

    def _predicted(self, states: Array, t: float) -> PredictedTracking:
        """Predict the measurements of states (B, D)."""
        data = self._model.data
        row = self._rows[np.argmin(np.abs(data.times[self._rows] - t))]
        rows = np.full(len(states), row)
        now = replace(
            data,
            times=np.full(len(states), t),
            values=data.values[rows],
            stations=(self.station.name,),
            station=np.zeros(len(states), dtype=np.int64),
            weather=data.weather[rows],
            wavelength=data.wavelength[rows],
            deviations=data.deviations[rows],
            rows=None,
        )
        return self._model.of((self.station,), now)(NearbyStates(t, states[:, :SIZE]))

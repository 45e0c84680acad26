"""Flow of a satellite under known forces, usable like a learned flow in filters and forecasts.

States are [position, velocity, parameters of the forces, constants], shape (B, D), km and km/s in GCRF; the
constants are other estimated quantities. Time is counted from the epoch of the forces.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from torch import Tensor

from ahnn.errors import TrainingError
from ahnn.tracking.satellite_arc import FLOOR, PRECISION, Forces, satellite_arc
from ahnn.types import TimeStep

Array = NDArray[np.float64]
SIZE = 6
"""Number of components of position and velocity."""


class SatelliteFlow:
    """Time-dependent flow under given forces.

    Args:
        forces: forces on the satellite.
        known: values of all force parameters, (P,).
        free: mask of the parameters in the state, (P,) bool; all other parameters keep their known value.
    """

    clock = 1

    def __init__(self, forces: Forces, known: Array, free: NDArray[np.bool_]) -> None:
        self.forces, self.known, self.free = forces, known, free

    def at(self, time: float | Tensor) -> SatelliteStep:
        """Return the flow from a given time."""
        return SatelliteStep(self, float(time))

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states at time dt, from states x at time zero."""
        return self.at(0.0)(x, dt)

    def parameters(self, x: Array) -> Array:
        """Return all force parameters for states (..., D), shape (..., P)."""
        p = np.broadcast_to(self.known, (*x.shape[:-1], len(self.known))).copy()
        p[..., self.free] = x[..., SIZE : SIZE + int(self.free.sum())]
        return p


class SatelliteStep(NamedTuple):
    """Flow under given forces from a given time.

    Attributes:
        flow: flow at any time.
        time: start time, seconds after the epoch.
    """

    flow: SatelliteFlow
    time: float

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states (B, D) after dt, with the same integration steps for all (see `satellite_arc`).

        Raises:
            TrainingError: the integration fails, for example for a satellite that falls into the Earth.
        """
        before, length = x.detach().numpy(), float(dt)
        forces, p, shape = self.flow.forces, self.flow.parameters(before), (len(before), SIZE)

        def slope(t: float, y: Array) -> Array:
            states = y.reshape(shape)
            return np.concatenate((states[:, 3:], forces.acceleration(t, states, p)[0]), axis=1).ravel()

        done = solve_ivp(
            slope,
            (self.time, self.time + length),
            before[:, :SIZE].ravel(),
            "DOP853",
            rtol=PRECISION,
            atol=FLOOR,
            first_step=min(length, forces.longest),
            max_step=forces.longest,
        )
        if not done.success:
            message = (
                f"orbit: the integration from {self.time:.0f} s stopped at {done.t[-1]:.0f} s: {done.message}"
            )
            raise TrainingError(message)
        after = before.copy()
        after[:, :SIZE] = done.y[:, -1].reshape(shape)
        return torch.from_numpy(after)

    def transition(self, x: Tensor, dt: TimeStep) -> tuple[Tensor, Tensor]:
        """Return the states (B, D) after dt, and the state transitions (B, D, D); raises TrainingError."""
        before, end = x.detach().numpy(), self.time + float(dt)
        after, moved = before.copy(), np.tile(np.eye(x.shape[-1]), (len(before), 1, 1))
        p, places = self.flow.parameters(before), np.concatenate((np.ones(SIZE, dtype=bool), self.flow.free))
        for k, one in enumerate(before):
            arc = satellite_arc(self.flow.forces, one[:SIZE], p[k], self.time, self.time, end)
            after[k, :SIZE] = arc.states(np.array([end]))[0]
            moved[k, :SIZE, : int(places.sum())] = arc.sensitivities(np.array([end]))[0][:, places]
        return torch.from_numpy(after), torch.from_numpy(moved)

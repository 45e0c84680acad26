"""Planetary trajectories from JPL's ephemeris DE421, fitted to observations.

Folkner, Williams and Boggs, The Planetary and Lunar Ephemeris DE421, IPN Progress Report 42-178 (2009).
"""

from __future__ import annotations

from typing import Any, final

import numpy as np

from ahnn.arguments import Count, Finite, Positive, checked
from ahnn.errors import UserError
from ahnn.optional_libraries import library
from ahnn.systems import System
from ahnn.types import Space, Trajectories, Units
from ahnn_plugins.demonstrations.segmented_series import segmented


@final
@checked
class Planets:
    """Heliocentric positions and velocities in au and au/d, in ICRF axes, with time in TDB days.

    Args:
        name: name of the data, in folders and tables.
        planets: names as in DE421; `earthmoon` is the barycentre of Earth and Moon.
        begin: Julian date of the first sample, TDB.
        step: days between two samples.
        samples: number of samples per segment, i.e. trajectory.
        segments: number of consecutive segments per planet.

    Raises:
        UserError: a planet or dates that DE421 does not contain.
    """

    truth: System | None = None

    def __init__(
        self, name: str, planets: list[str], begin: Finite, step: Positive, samples: Count, segments: Count
    ) -> None:
        self.planets, self.begin, self.step = planets, begin, step
        self.samples, self.segments = samples, segments
        units = Units(time="d", position="au", velocity="au/d", energy="au²/d²")
        self.space = Space(name, ("x", "y", "z", "vx", "vy", "vz"), units, frame="ICRF, SUN")
        data = library("de421", "de421", "ephemeris", "system")
        self._ephemeris = library("jplephem.ephem", "jplephem", "ephemeris", "system").Ephemeris(data)
        self._check()

    def recipe(self) -> dict[str, Any]:
        """Return the definition of the samples."""
        known = ("planets", "begin", "step", "samples", "segments")
        return {"ephemeris": "DE421", **{name: getattr(self, name) for name in known}}

    def steps(self) -> int:
        """Return the number of steps per segment."""
        return self.samples - 1

    def read(self) -> Trajectories:
        """Return the segments, ordered by start time and then planet."""
        times = self.step * np.arange(self.segments * self.samples)
        sun = self._barycentric("sun", times)
        states = np.stack([self._barycentric(planet, times) - sun for planet in self.planets])
        return segmented(states, times, self.samples)

    def _barycentric(self, body: str, times: np.ndarray) -> np.ndarray:
        """Return states (T, 6) in au and au/d, about the barycentre of the solar system."""
        position, velocity = self._ephemeris.position_and_velocity(body, self.begin, times)
        return np.concatenate((position, velocity)).T / self._ephemeris.AU

    def _check(self) -> None:
        known = sorted({*self._ephemeris.names} - {"librations", "nutations", "sun", "moon"})
        wrong = [planet for planet in self.planets if planet not in known]
        if wrong or not self.planets:
            message = f"planets: expected one or more of {', '.join(known)}; received {wrong or 'none'}"
            raise UserError(message)
        first, last = self._ephemeris.jalpha, self._ephemeris.jomega
        end = self.begin + self.step * self.samples * self.segments
        if not (first <= self.begin and end <= last):
            message = (
                f"begin, step, samples, segments: expected Julian dates from {first} to {last}; received "
                f"{self.begin} to {end}"
            )
            raise UserError(message)

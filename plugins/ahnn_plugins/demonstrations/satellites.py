"""Satellite trajectories by SGP4, from its published verification element sets.

Vallado, Crawford, Hujsak and Kelso, Revisiting Spacetrack Report #3, AIAA 2006-6753, describe the sets, the
method and its constants (WGS-72). The package sgp4 contains the sets as a file.
"""

from __future__ import annotations

from importlib.resources import files
from typing import Any, final

import numpy as np

from ahnn.arguments import Count, Positive, checked
from ahnn.errors import UserError
from ahnn.optional_libraries import library
from ahnn.systems import System
from ahnn.training.objectives import difference_weights
from ahnn.types import Space, Trajectories, Units
from ahnn_plugins.demonstrations.segmented_series import segmented

APART, ORDER = 10.0, 8
"""Spacing, in seconds, of the positions for numerical velocities, and order of the differences."""
DAY = 86400.0


@final
@checked
class Satellites:
    """Positions and velocities in km and km/s, in TEME axes at the epoch of each set.

    Times are in UTC seconds from 0 h on the day of the first set.

    Velocities are derivatives of the positions, from which the velocities reported by SGP4 differ by up to
    2 m/s near the perigee of Molniya orbits.

    Args:
        name: name of the data, in folders and tables.
        satellites: catalogue numbers.
        step: seconds between two samples.
        samples: number of samples per segment, i.e. trajectory.
        segments: number of consecutive segments per satellite.

    Raises:
        UserError: a satellite without a verification set, or one that SGP4 cannot propagate that long.
    """

    truth: System | None = None

    def __init__(
        self, name: str, satellites: list[Count], step: Positive, samples: Count, segments: Count
    ) -> None:
        self.satellites, self.step, self.samples, self.segments = satellites, step, samples, segments
        units = Units(time="s", position="km", velocity="km/s", energy="km²/s²")
        self.space = Space(name, ("x", "y", "z", "vx", "vy", "vz"), units, frame="TEME, EARTH")
        known = element_sets()
        wrong = [number for number in satellites if number not in known]
        if wrong or not satellites:
            names = ", ".join(map(str, known))
            message = f"satellites: expected one or more of {names}; received {wrong or 'none'}"
            raise UserError(message)
        self._sets = [known[number] for number in satellites]

    def recipe(self) -> dict[str, Any]:
        """Return the element sets, and the definition of the samples."""
        known = ("satellites", "step", "samples", "segments")
        sets = [list(lines) for lines in self._sets]
        return {"sgp4": sets, **{name: getattr(self, name) for name in known}}

    def steps(self) -> int:
        """Return the number of steps per segment."""
        return self.samples - 1

    def read(self) -> Trajectories:
        """Return the segments, ordered by start time and then satellite."""
        times = self.step * np.arange(self.segments * self.samples)
        states = np.stack([moved(lines, times) for lines in self._sets])
        epochs = np.array([days_since_1950(lines) for lines in self._sets])
        begins = DAY * (epochs - np.floor(epochs.min()))
        return segmented(states, begins[:, None] + times, self.samples)


def element_sets() -> dict[int, tuple[str, str]]:
    """Return both lines of each verification element set, by catalogue number."""
    text = files(library("sgp4", "sgp4", "orbit", "system")).joinpath("SGP4-VER.TLE").read_text()
    lines = [line[:69] for line in text.splitlines() if line[:2] in ("1 ", "2 ")]
    return {int(one[2:7]): (one, two) for one, two in zip(lines[::2], lines[1::2], strict=True)}


def days_since_1950(lines: tuple[str, str]) -> float:
    """Return the epoch of an element set in days after 1950-01-00, 0 h UTC, as in SGP4."""
    satellite = library("sgp4.api", "sgp4", "orbit", "system").Satrec.twoline2rv(*lines)
    return (satellite.jdsatepoch - 2433281.5) + satellite.jdsatepochF


def moved(lines: tuple[str, str], times: np.ndarray) -> np.ndarray:
    """Return states (T, 6) at times (T,) in s from the epoch of an element set.

    Raises:
        UserError: SGP4 fails.
    """
    satellite = library("sgp4.api", "sgp4", "orbit", "system").Satrec.twoline2rv(*lines)

    def positions(t: np.ndarray) -> np.ndarray:
        whole = np.full(len(t), satellite.jdsatepoch)
        codes, found, _ = satellite.sgp4_array(whole, satellite.jdsatepochF + t / DAY)
        if (failed := codes.nonzero()[0]).size:
            day = t[failed[0]] / DAY
            message = (
                f"samples, segments: expected times that SGP4 reaches with satellite {lines[0][2:7]}; "
                f"received day {day:.1f}, where its error is {codes[failed[0]]}"
            )
            raise UserError(message)
        return found

    around = [positions(times + APART * k) for k in range(-ORDER // 2, ORDER // 2 + 1)]
    velocities = np.einsum("w,wtd->td", difference_weights(ORDER).numpy(), np.diff(around, axis=0)) / APART
    return np.concatenate((around[ORDER // 2], velocities), axis=1)

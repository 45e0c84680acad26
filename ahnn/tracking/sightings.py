"""Data source for training on station measurements: files of ranges, angles and range rates of satellites.

States refer to the true equator of the first day (CIRS of that day), about whose pole the Earth is symmetric.
Stations move with precession, nutation, UT1 and polar motion; refraction is not modelled.
"""

from __future__ import annotations

import hashlib
import logging
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from torch.nn.functional import pad

from ahnn.arguments import Within, checked
from ahnn.data.files.epochs import SECOND, spelled
from ahnn.data.files.frame_names import FIXED_AT
from ahnn.data.files.raw import content_of
from ahnn.data.files.reading import bytes_of
from ahnn.data.files.samples import Track, filled, stacked, trimmed
from ahnn.data.files.samples import cut as cut_to
from ahnn.data.files.source import require_different
from ahnn.data.reference import Reference
from ahnn.errors import UserError
from ahnn.measurements import Observations, StationsOfFile, continuous, periods
from ahnn.systems import System
from ahnn.tracking.earth_axes import earth_axes
from ahnn.tracking.formats.tracking_files import read_tracking
from ahnn.tracking.tracking_data import KINDS, TrackingData
from ahnn.types import Space, Trajectories, Units

log = logging.getLogger(__name__)
UNITS = Units("s", "km", "km/s", "km²/s²")
UNKNOWNS = 6
"""Number of components of the initial state of a segment, which so many measured values spend."""


def of_first_day(epoch: int) -> Reference:
    """Return the reference of states with an epoch of time zero, in picoseconds of UTC."""
    day = spelled(epoch, utc=True).partition("T")[0]
    return Reference(f"CIRS{FIXED_AT}{day}T00:00:00", "EARTH", "UTC", epoch)


@checked
class Sightings:
    """Trajectories of satellites from station measurements, per unit mass.

    Args:
        name: name of the data, in folders and tables.
        path: path of one or several files, in the formats of `read_tracking`; each satellite of a file is a
            trajectory.
        stations: file of the stations, see `ahnn.measurements.station_file`; only measurements with a stated
            noise are used.
        cut: number of times of the segments into which trajectories are cut; None: not cut.
        gap: multiple of the median step that counts as a gap, for times not on a grid.

    Attributes:
        measurement: measurement model of the stations named in the files, side by side.

    Raises:
        UserError: a file that cannot be read, an unknown station, no measurement whose noise is specified, or
            no pyerfa.
    """

    truth: System | None = None

    def __init__(
        self,
        name: str,
        path: str | list[str],
        stations: str,
        cut: Annotated[int, Within(2)] | None = None,
        gap: Annotated[float, Within(1.5)] = 10.0,
    ) -> None:
        paths = [Path(p).expanduser() for p in ([path] if isinstance(path, str) else path)]
        require_different(paths)
        self.cut, self.gap, file = cut, gap, Path(stations).expanduser()
        found = [(str(path), data) for path in paths for data in read_tracking(path)]
        reference = of_first_day(min(data.epoch for _, data in found))
        seen = [name for _, data in found for name in data.stations]
        self.measurement = StationsOfFile(str(file), earth_axes(reference), only=[*dict.fromkeys(seen)])
        components = ("x", "y", "z", "px", "py", "pz")
        self.space = Space(name, components, UNITS, frame=str(reference))
        raw = [part for path in paths for part in bytes_of(path)] + [content_of(file)]
        self._sha256 = hashlib.sha256(
            b"".join(hashlib.sha256(part or b"").digest() for part in raw)
        ).hexdigest()
        tracks = [self._track(file, data, reference.epoch or 0) for file, data in found]
        pieces = [piece for track in tracks for piece in cut_to(filled(track, gap), cut)]
        parts = [trimmed(piece, partly=True) for piece in pieces]
        parts = [part for part in parts if len(part.times)]
        values, times = stacked(parts)[:2]
        self._observations = Observations(continuous(values, periods(self.measurement)), times)
        shown = self.measurement.locate(values, times)
        self._trajectories = Trajectories(pad(shown, (0, 3), value=torch.nan), times)
        log.info("%s: %s", name, self._described())
        few = sum(int(np.isfinite(part.values).sum()) <= UNKNOWNS for part in parts)
        if few:
            message = "%s: %d of %d segments have at most %d measured values, from which nothing is learned%s"
            remedy = "" if cut is None else ". Set a larger system.cut"
            log.warning(message, name, few, len(parts), UNKNOWNS, remedy)

    def recipe(self) -> dict[str, Any]:
        """Return the hash of the files, the cut and the frame."""
        frame = Reference.of(self.space.frame).frame
        return {"files": self._sha256, "cut": self.cut, "gap": self.gap, "frame": frame}

    def steps(self) -> int:
        """Return the number of steps of the shortest trajectory."""
        return int(self._observations.times.isfinite().sum(1).min()) - 1

    def read(self) -> Trajectories:
        """Return the positions given by simultaneous ranges and angles, NaN elsewhere; momenta are NaN."""
        return self._trajectories

    def sensors(self) -> StationsOfFile:
        """Return the measurement model of the stations, side by side."""
        return self.measurement

    def observations(self) -> Observations:
        """Return the measurements of all stations side by side, (B, T, M), NaN where missing."""
        return self._observations

    def _track(self, file: str, data: TrackingData, epoch: int) -> Track:
        """Return the measurements of a satellite at each of its times."""
        times, row = np.unique(data.times, return_inverse=True)
        values = np.full((len(times), len(self.measurement.names)), np.nan)
        first, unused = 0, set[str]()
        columns: dict[str, dict[int, int]] = {}
        for name, station in self.measurement.stations.items():
            if name in data.stations and station.event != data.event:
                message = (
                    f"stations: {name}.event: expected {data.event}, as in {file}; received {station.event}. "
                    "State the event in the station file, or in a sidecar for the measurements"
                )
                raise UserError(message)
            columns[name] = {k: first + c for c, k in enumerate(station.kept)}
            first += len(station.kept)
        for s, name in enumerate(data.stations):
            for k, kind in enumerate(KINDS):
                own = np.flatnonzero((data.station == s) & np.isfinite(data.values[:, k]))
                if k not in columns[name]:
                    unused |= {f"{name}.{kind}"} if len(own) else set()
                    continue
                if len(np.unique(row[own])) < len(own):
                    message = f"{file}: expected {kind} of {name} once at each time; received two"
                    raise UserError(message)
                values[row[own], columns[name][k]] = data.values[own, k]
        if unused:
            log.warning(
                "%s: measurements without stated noise are not used: %s", file, ", ".join(sorted(unused))
            )
        if np.isfinite(data.deviations).any():
            log.warning("%s: the standard deviations are ignored; the noise of the stations is used", file)
        after = (data.epoch - epoch) / SECOND
        return Track(data.object, file, np.arange(1, len(times) + 1), times + after, values)

    def _described(self) -> str:
        seen = self._observations.values.isfinite()
        lengths = sorted({int(n) for n in seen.any(-1).sum(1)})
        times = f"{lengths[0]:,}" if lengths[0] == lengths[-1] else f"{lengths[0]:,} to {lengths[-1]:,}"
        counts = ", ".join(f"{n} {int(seen[..., k].sum()):,}" for k, n in enumerate(self.measurement.names))
        many = "trajectory" if len(seen) == 1 else "trajectories"
        return f"{len(seen)} {many} of {times} times: {counts}"

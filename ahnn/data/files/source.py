"""Trajectories and measurements of one's own, from files."""

from __future__ import annotations

import hashlib
import logging
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from ahnn.arguments import Positive, Within, checked
from ahnn.data.files import frame_names
from ahnn.data.files.content import Content, since_first
from ahnn.data.files.frame_names import ROTATING
from ahnn.data.files.reading import Reading, bytes_of, parsed
from ahnn.data.files.samples import Track, cut, filled, stacked, trimmed
from ahnn.data.files.table import Place
from ahnn.errors import UserError
from ahnn.systems import System
from ahnn.types import Space, Trajectories

log = logging.getLogger(__name__)


@checked
class Files:
    """Trajectories in files; nothing is known of their equations.

    Times, positions and velocities or momenta are columns with units behind their names (docs/data.md).

    Args:
        name: of the data, in folders and tables.
        path: of the file, or of several.
        mass: factor m of p = m dq/dt, in kg (of angles: the inertia in kg m^2); None is 1, with energies per
            unit mass.
        cut: samples of the stretches that trajectories are cut into; None leaves them whole.
        gap: a step so many times longer than the median is a gap, where samples lie on no grid.
        frame: into which data of a known frame and epoch are turned; None leaves them as they are.
        step, duration: in seconds, of what SGP4 propagates from element sets.
        unsound: train also on data that `check` finds unfit.

    Raises:
        UserError: a file that cannot be read, names row and column; or files that do not fit each other.
    """

    truth: System | None = None

    def __init__(
        self,
        name: str,
        path: str | list[str],
        mass: Positive | None = None,
        cut: Annotated[int, Within(2)] | None = None,
        gap: Annotated[float, Within(1.5)] = 10.0,
        frame: Literal["GCRF", "EME2000"] | None = None,
        step: Positive | None = None,
        duration: Positive | None = None,
        unsound: bool = False,
    ) -> None:
        self.paths = [Path(p).expanduser() for p in ([path] if isinstance(path, str) else path)]
        self.mass, self.cut, self.gap, self.unsound = mass, cut, gap, unsound
        self.reading = Reading(mass is not None, frame, step, duration)
        require_different(self.paths)
        digest = hashlib.sha256()
        contents = []
        for file in self.paths:
            raw, aside = bytes_of(file)
            digest.update(
                hashlib.sha256(raw).digest() + (hashlib.sha256(aside).digest() if aside is not None else b"")
            )
            contents.append(parsed(file, raw, aside, self.reading))
        contents = since_first(contents)
        first = together(self.paths, contents)
        self.positions_only, self.momenta = not first.rates, first.momenta
        if first.momenta and mass is None:
            message = (
                f"system.mass: expected the mass of p = m dq/dt for the momenta {', '.join(first.rates)} of "
                f"{self.paths[0]}; received null. system.mass=1 takes them per unit mass"
            )
            raise UserError(message)
        self.space = space_of(name, first, mass)
        if first.frame.upper().startswith(ROTATING):
            log.warning("%s: frame %s rotates: mass times velocity is no momentum in it", name, first.frame)
        self.trajectories = self._trajectories(contents)
        self.epoch = first.epoch
        self._contents = contents
        self._sha256 = digest.hexdigest()

    def check(self) -> None:
        """Refuse data that would spoil a training, unless `unsound` takes them; raises UserError."""
        from ahnn.data.doctor import diagnosis

        found = [] if self.unsound else diagnosis(self._contents, self.mass, self.gap)
        faults = [one for one in found if one.level == "fault"]
        if faults:
            (_, file, row, column, what, remedy), rest = faults[0], len(faults) - 1
            more = f", and {rest} more" if rest else ""
            expected = f"{Place(file, row, column)}: expected sound data; received: {what}{more}. {remedy}"
            message = f"{expected}. python -m ahnn.data check lists all; system.unsound=true trains anyway"
            raise UserError(message)

    def recipe(self) -> dict[str, Any]:
        """Return the hash of the files, and how they are read."""
        options = {"mass": self.mass, "cut": self.cut, "gap": self.gap}
        asked = {name: getattr(self.reading, name) for name in ("frame", "step", "duration")}
        return {"files": self._sha256, **options, **{k: v for k, v in asked.items() if v is not None}}

    def steps(self) -> int:
        """Return the steps of the shortest trajectory."""
        return int(self.trajectories.times.isfinite().sum(1).min()) - 1

    def read(self) -> Trajectories:
        """Return the trajectories; the momenta are NaN where the files have positions alone."""
        return self.trajectories

    def _trajectories(self, contents: list[Content]) -> Trajectories:
        """Return all tracks as states, momenta from velocities and the mass."""
        dof = self.space.dof
        tracks = [filled(track, self.gap) for content in contents for track in content.tracks]
        for track in tracks:
            if not len(trimmed(track).times):
                place = Place(track.file, int(track.rows[0]))
                place.refuse(f"a trajectory {track.name} with a whole sample", "missing numbers in each")
        parts = [trimmed(part) for track in tracks for part in cut(track, self.cut)]
        parts = [part for part in parts if len(part.times)]
        factor = np.ones(2 * dof)
        if not contents[0].momenta:
            factor[dof:] = self.space.inertia
        whole = [part._replace(values=widened(part, dof) * factor) for part in parts]
        self.names = tuple(part.name for part in parts)
        log.info("%s: %s", self.space.name, described(self.space, parts, contents[0]))
        return stacked(whole)


def require_different(paths: list[Path]) -> None:
    """Refuse a file that is named twice: training would see the test trajectories; raises UserError."""
    known = [path.resolve() for path in paths]
    if again := [path for path in paths if known.count(path.resolve()) > 1]:
        message = f"system.path: expected different files; received {again[0]} twice"
        raise UserError(message)


def together(paths: list[Path], contents: list[Content]) -> Content:
    """Return the first of several contents, the others being of the same kind; raises UserError otherwise."""
    if not contents:
        message = "system.path: expected a file or several; received none"
        raise UserError(message)
    for name in ("positions", "rates", "momenta", "units", "frame"):
        first = getattr(contents[0], name)
        for path, content in zip(paths, contents, strict=True):
            if (received := getattr(content, name)) != first:
                remedy = frame_names.remedy(str(first), str(received)) if name == "frame" else ""
                expected = f"{name} {spelled(first)}, as in {paths[0]}"
                Place(str(path)).refuse(expected, spelled(received) or "none", remedy)
    return contents[0]


def spelled(value: Any) -> str:
    """Return names in a row as a text."""
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def space_of(name: str, content: Content, mass: float | None) -> Space:
    """Return what the numbers mean."""
    momenta = content.rates if content.momenta else tuple(f"p{q}" for q in content.positions)
    turning = content.momenta and content.frame.upper().startswith(ROTATING)
    parts = (*content.positions, *momenta), content.units, mass or 1.0, content.frame
    return Space(name, *parts, mechanical=not turning)


def widened(track: Track, dof: int) -> Any:
    """Return the values of a track with a column for each component, (T, 2n)."""
    missing = 2 * dof - track.values.shape[1]
    return np.pad(track.values, ((0, 0), (0, missing)), constant_values=np.nan)


def described(space: Space, tracks: list[Track], content: Content) -> str:
    """Return what was read, so that a user sees what each column was taken for."""
    lengths = sorted({int(np.isfinite(track.values).any(1).sum()) for track in tracks})
    samples = f"{lengths[0]:,}" if lengths[0] == lengths[-1] else f"{lengths[0]:,} to {lengths[-1]:,}"
    kind = "momenta" if content.momenta else "velocities"
    rates = f", {kind} {', '.join(content.rates)}" if content.rates else " alone"
    return (
        f"{len(tracks)} {'trajectory' if len(tracks) == 1 else 'trajectories'} of {samples} samples, time in "
        f"{space.units.time}, positions {', '.join(content.positions)} in {space.units.position}{rates}"
    )

"""Recorded trajectories from files or Python, in the form used by training."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from ahnn.data.files.content import Content
from ahnn.data.files.frame_names import ROTATING
from ahnn.data.files.object_name import ObjectName
from ahnn.data.files.samples import Track, cut, filled, stacked, trimmed
from ahnn.data.files.table import Place
from ahnn.errors import UserError
from ahnn.systems import System
from ahnn.types import Space, Trajectories

log = logging.getLogger(__name__)


class Recordings(ABC):
    """Recorded trajectories of states or measurements, with unknown equations.

    Args:
        space: description of the state components.
        contents: contents of one kind: positions with momenta or velocities, or positions only.
        mass: factor m of p = m dq/dt; None if unspecified.
        cut: number of samples of the segments into which trajectories are cut; None: not cut.
        gap: multiple of the median step that counts as a gap, for samples not on a grid.
        unsound: whether to accept data rejected by `check`.

    Attributes:
        positions_only: whether only positions were recorded.
        trajectories: recorded trajectories, NaN where missing.
        objects: objects of the trajectories; the identifier of an unnamed one is "".

    Raises:
        UserError: a trajectory without a complete sample, or with too long a gap.
    """

    truth: System | None = None
    lists = ""
    """Reference to the complete list of findings, for the message of `check`."""

    def __init__(
        self,
        space: Space,
        contents: list[Content],
        mass: float | Sequence[float] | str | None,
        *,
        cut: int | None,
        gap: float,
        unsound: bool,
    ) -> None:
        self.space, self.positions_only = space, not contents[0].rates
        self.momenta = contents[0].momenta
        self.mass, self.cut, self.gap, self.unsound = mass, cut, gap, unsound
        self.trajectories = self._trajectories(contents)
        self._contents = contents

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the trajectories."""
        return tuple(one.id for one in self.objects)

    def check(self) -> None:
        """Raise UserError for data that would spoil the training, unless `unsound` is set.

        Warnings about a whole column are logged.
        """
        from ahnn.data.doctor import diagnosis

        if self.space.frame.upper().startswith(ROTATING):
            message = "%s: frame %s rotates, so that mass times velocity is not a momentum"
            log.warning(message, self.space.name, self.space.frame)
        found = [] if self.unsound else diagnosis(self._contents, self.mass, self.gap)
        heads = {(content.tracks[0].file, content.head) for content in self._contents}
        for one in found:
            if one.level == "warning" and one.column and (one.file, one.row) in heads:
                log.warning("%s: %s. %s", Place(one.file, one.row, one.column), one.what, one.remedy)
        faults = [one for one in found if one.level == "fault"]
        if faults:
            (_, file, row, column, what, remedy, _), rest = faults[0], len(faults) - 1
            more = f", and {rest} more" if rest else ""
            expected = f"{Place(file, row, column)}: expected valid data; received: {what}{more}. {remedy}"
            message = f"{expected}. {self.lists}Set system.unsound=true to train anyway"
            raise UserError(message)

    @abstractmethod
    def recipe(self) -> dict[str, Any]:
        """Return the complete definition of the trajectories, as plain values."""

    def steps(self) -> int:
        """Return the number of steps of the shortest trajectory."""
        return int(self.trajectories.times.isfinite().sum(1).min()) - 1

    def read(self) -> Trajectories:
        """Return the trajectories; momenta are NaN if only positions are known."""
        return self.trajectories

    def _trajectories(self, contents: list[Content]) -> Trajectories:
        """Return all tracks as states, with momenta from velocities and the mass."""
        dof, linear = self.space.dof, contents[0].linear
        every = (track for content in contents for track in content.tracks)
        tracks = [filled(track, self.gap, linear=linear) for track in every]
        for track in tracks:
            if not len(trimmed(track).times):
                place = Place(track.file, int(track.rows[0]) if len(track.rows) else 0)
                named = " ".join(("a trajectory", *filter(None, [track.name])))
                remedy = "Leave out a column that is empty"
                place.refuse(f"{named} with a complete sample", "missing values in each sample", remedy)
        parts = [trimmed(part) for track in tracks for part in cut(track, self.cut)]
        parts = [part for part in parts if len(part.times)]
        factor = np.ones(2 * dof)
        if not contents[0].momenta:
            factor[dof:] = self.space.inertia
        whole = [part._replace(values=widened(part, dof) * factor) for part in parts]
        self.objects = tuple(ObjectName(part.name, part.title, part.designator) for part in parts)
        log.info("%s: %s", self.space.name, described(self.space, parts, contents[0]))
        return stacked(whole, linear=linear)


def widened(track: Track, dof: int) -> Any:
    """Return the values of a track with all state components, (T, 2n)."""
    missing = 2 * dof - track.values.shape[1]
    return np.pad(track.values, ((0, 0), (0, missing)), constant_values=np.nan)


def described(space: Space, tracks: list[Track], content: Content) -> str:
    """Describe the data read, with the interpretation of each column."""
    lengths = sorted({int(np.isfinite(track.values).any(1).sum()) for track in tracks})
    samples = f"{lengths[0]:,}" if lengths[0] == lengths[-1] else f"{lengths[0]:,} to {lengths[-1]:,}"
    kind = "momenta" if content.momenta else "velocities"
    rest = f", {kind} {', '.join(content.rates)}" if content.rates else " only"
    rest += f", controls {', '.join(content.controls)}" if content.controls else ""
    return (
        f"{len(tracks)} {'trajectory' if len(tracks) == 1 else 'trajectories'} of {samples} samples, time in "
        f"{space.units.time}, positions {', '.join(content.positions)} in {space.units.position}{rest}"
    )

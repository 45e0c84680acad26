"""Data source of user-supplied files."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from ahnn.arguments import Positive, Within, checked
from ahnn.data.files import frame_names
from ahnn.data.files.content import CANONICAL, Content, since_first
from ahnn.data.files.frame_names import ROTATING
from ahnn.data.files.reading import FileReading, bytes_of, parsed
from ahnn.data.files.recordings import Recordings
from ahnn.data.files.table import Place
from ahnn.data.files.unit_factors import energy_unit
from ahnn.data.files.units import unit
from ahnn.errors import UserError
from ahnn.types import Space


@checked
class Files(Recordings):
    """Trajectories in files, with unknown equations.

    Times, positions, velocities or momenta, and controls are columns with units after their names
    (docs/data.md).

    Args:
        name: name of the data, in folders and tables.
        path: path of one or several files; None is an error.
        mass: factor m of p = m dq/dt, in kg (for angles, the inertia in kg m^2), common or per coordinate;
            None for 1, with energies per unit mass; `canonical` for momenta without such a factor.
        cut: number of samples of the segments into which trajectories are cut; None: not cut.
        gap: multiple of the median step that counts as a gap, for samples not on a grid.
        frame: target frame for data of known frame and epoch; None: no transformation.
        step: sampling step of SGP4 orbits from element sets, in seconds.
        duration: duration of these orbits, in seconds.
        unsound: whether to accept data rejected by `check`.

    Raises:
        UserError: a file that cannot be read (the message gives row and column), or incompatible files.
    """

    lists = "`python -m ahnn.data check` lists all faults. "
    of_starts = False
    """Whether only initial states are read, which makes remarks on training irrelevant."""

    def __init__(
        self,
        name: str,
        path: str | list[str] | None,
        mass: Positive | list[Positive] | Literal["canonical"] | None = None,
        cut: Annotated[int, Within(2)] | None = None,
        gap: Annotated[float, Within(1.5)] = 10.0,
        frame: Literal["GCRF", "EME2000"] | None = None,
        step: Positive | None = None,
        duration: Positive | None = None,
        unsound: bool = False,
    ) -> None:
        if not path:
            message = "system.path: expected the path of your data; received none. Set system.path=FILE"
            raise UserError(message)
        self.paths = [Path(p).expanduser() for p in ([path] if isinstance(path, str) else path)]
        self.reading = FileReading(frame, step, duration, self.of_starts)
        require_different(self.paths)
        digest = hashlib.sha256()
        contents = []
        for file in self.paths:
            raw, aside = bytes_of(file, "system.path")
            digest.update(
                hashlib.sha256(raw).digest() + (hashlib.sha256(aside).digest() if aside is not None else b"")
            )
            contents.append(parsed(file, raw, aside, self.reading))
        contents = since_first(contents)
        first = together(self.paths, contents)
        mass = CANONICAL if first.general and mass is None else mass
        if first.momenta and mass is None:
            message = (
                f"system.mass: expected the mass in p = m dq/dt for the momenta {', '.join(first.rates)} in "
                f"{self.paths[0]}; received null. Set system.mass=1 for momenta per unit mass, or "
                f"system.mass={CANONICAL} if they are not mass times velocity, as those of coupled angles"
            )
            raise UserError(message)
        if mass == CANONICAL and not first.momenta:
            message = (
                f"system.mass: expected a number without momenta in {self.paths[0]}; received {mass}. Name "
                "momenta p1, p2, ..."
            )
            raise UserError(message)
        space = space_of(name, first, mass)
        super().__init__(space, contents, mass, cut=cut, gap=gap, unsound=unsound)
        self.epoch = first.epoch
        self._sha256 = digest.hexdigest()

    def recipe(self) -> dict[str, Any]:
        """Return the hash of the files, and their reading options."""
        options = {"mass": self.mass, "cut": self.cut, "gap": self.gap}
        asked = {name: getattr(self.reading, name) for name in ("frame", "step", "duration")}
        return {"files": self._sha256, **options, **{k: v for k, v in asked.items() if v is not None}}


class StartFiles(Files):
    """Initial states in files; their standard deviations are used by the reader of starts."""

    of_starts = True


def require_different(paths: list[Path]) -> None:
    """Raise UserError for a file given twice, which would leak test trajectories into training."""
    known = [path.resolve() for path in paths]
    if again := [path for path in paths if known.count(path.resolve()) > 1]:
        message = f"system.path: expected different files; received {again[0]} twice"
        raise UserError(message)


def together(paths: list[Path], contents: list[Content]) -> Content:
    """Return the first of several contents after checking that they match; raises UserError otherwise."""
    for name in ("positions", "rates", "stated_momenta", "units", "frame", "measured_controls", "linear"):
        first = getattr(contents[0], name)
        for path, content in zip(paths, contents, strict=True):
            if (received := getattr(content, name)) != first:
                remedy = frame_names.remedy(str(first), str(received)) if name == "frame" else ""
                expected = f"{name.rpartition('_')[2]} {spelled(first)}, as in {paths[0]}"
                Place(str(path)).refuse(expected, spelled(received) or "none", remedy)
    return contents[0]


def spelled(value: Any) -> str:
    """Join names to a text."""
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def space_of(name: str, content: Content, mass: float | Sequence[float] | str | None) -> Space:
    """Build the space of the data, with energies per unit mass if no mass is stated."""
    length, time = unit(content.units.position), unit(content.units.time)
    units = content.units._replace(energy=energy_unit(length, time, weighed=mass is not None))
    momenta = content.rates if content.momenta else tuple(f"p{q}" for q in content.positions)
    general = content.momenta and content.frame.upper().startswith(ROTATING)
    if isinstance(mass, str):
        general, mass = True, None
    inertia = (*mass,) if isinstance(mass, Sequence) else mass or 1.0
    if isinstance(inertia, tuple) and len(inertia) != len(content.positions):
        message = (
            f"system.mass: expected one mass, or one for each of {content.positions}; received {inertia}"
        )
        raise UserError(message)
    parts = (*content.positions, *momenta), units, inertia, content.frame
    return Space(name, *parts, mechanical=not general, controls=content.controls)

"""Column roles of a file: time, trajectory id, positions, velocities or momenta, and controls."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from ahnn.arguments import nearest
from ahnn.data.files.kinds import NO_STATION, SIGHTINGS_ALONE
from ahnn.data.files.sidecar import beside
from ahnn.data.files.table import Header, Place

TIMES, EPOCH, IDS = ("t", "time"), "epoch", ("id", "trajectory")
Kind = Literal["velocities", "momenta"]
ROLES = ("time", "id", "positions", "velocities", "momenta", "controls")
SIDECAR = "Name the columns in a sidecar (docs/data.md)"
NAMES: dict[Kind, tuple[str, ...]] = {
    "velocities": (
        *("v{}", "vel{}", "velocity{}", "{}vel", "{}velocity"),
        *("{}dot", "{}'", "d{}", "d{}dt", "d{}/dt"),
    ),
    "momenta": ("p{}", "mom{}", "momentum{}", "{}mom", "{}momentum"),
}
"""Names of the velocity and momentum of a position, in lower case and without underscores."""
OF_ANGLES = ("w{}", "omega{}", "angularvelocity{}")
COORDINATE = re.compile(r"(?P<stem>q|x|(?P<angle>theta|phi|psi|alpha|angle))(?P<index>\d*)")
"""Positions whose velocity may be named by its index: v1 for q1, omega for theta."""
PLACED = re.compile(r"(position|pos|r|q)(?P<of>.*)")
"""Prefixes of position names: the velocity of rx or position_x is vx."""
DEVIATIONS, COVARIANCES = "sd_", "cov_"
"""Prefixes of standard deviations and covariances; training uses data.noise instead of them."""
BESIDE = ("t", "novelty", "novel")
"""Further columns of our predictions and final states: times beside epochs, and novelty."""
CONTROL = re.compile(r"u\d*|(control|input|torque|command|cmd)(_?\w+)?")
"""Names of control columns, if positions are also present."""
NO_POSITION = re.compile(
    r"[vpw]_?([xyzq]?_?\d*)|d_?[xyzq]_?\d*|omega.*|.*dot|.*(vel|velocity|mom|momentum)|(vel|mom|speed).*"
    r"|d.+dt|a_?[xyz]|.*acc|acc.*|(std|sigma|err|cov|var)_.*|.*_(sd|std|sigma|err)|.*'"
    r"|index|step|row|sample|energy|mass|unnamed.*"
)
"""Names that are not positions unless a sidecar defines them as such."""


def control_named(name: str, controls: Sequence[str]) -> str:
    """Return the canonical name of a column; for a single control any control name is accepted."""
    usual = len(controls) == 1 and CONTROL.fullmatch(name.lower())
    return controls[0] if usual else name


class Roles(NamedTuple):
    """Column indices by role.

    Attributes:
        time: column of the time.
        id: column of the trajectory id; None for a single trajectory.
        positions: columns of the n positions.
        rates: columns of the n velocities or momenta, in the order of the positions; empty if unknown.
        kind: kind of the rates: velocities or momenta.
        controls: columns of the controls.
    """

    time: int
    id: int | None
    positions: tuple[int, ...]
    rates: tuple[int, ...]
    kind: Kind
    controls: tuple[int, ...] = ()

    def of(self, column: int) -> str:
        """Return the role of a column."""
        if column in (self.time, self.id):
            return "time" if column == self.time else "id"
        rate = "velocity" if self.kind == "velocities" else "momentum"
        groups = {"position": self.positions, rate: self.rates, "control": self.controls}
        return next((role for role, columns in groups.items() if column in columns), "not used")


def roles(header: Header, named: dict[str, Any], place: Place) -> Roles:
    """Determine the roles of columns from a sidecar, or from their names in upper or lower case.

    By name, `t` or `time` is the time, or `epoch` in a table without them, and `id` or `trajectory` is the
    trajectory id; `rates_of` defines velocities and momenta, standard deviations begin with `sd_`, `CONTROL`
    defines controls, and all other columns are positions.

    Args:
        header: header of the file.
        named: mapping from roles to column names, as in a sidecar. If it names positions, all columns that it
            does not name are ignored; otherwise, their names determine their roles.
        place: place of the header.

    Raises:
        UserError: a missing column, a column without counterpart, or a position with the name of another
            quantity.
    """
    names, aside = header.names, Place(str(beside(Path(place.file))))
    known = of_sidecar(names, named, aside)
    if known.keys() & {"positions", *NAMES}:
        return selected(known, named, aside)
    time = known.get("time", [i for i, name in enumerate(names) if name.lower() in TIMES])
    time = time or [i for i, name in enumerate(names) if name.lower() == EPOCH]
    ids = known.get("id", [i for i, name in enumerate(names) if name.lower() in IDS])
    if len(time) != 1 or len(ids) > 1:
        expected = f"one column named {', '.join(TIMES)} or {EPOCH}, and at most one named {' or '.join(IDS)}"
        place.refuse(expected, ", ".join(names), SIDECAR)
    rest = [i for i in range(len(names)) if i not in (*time, *ids) and not is_deviation(names[i])]
    controls = known.get("controls", [i for i in rest if CONTROL.fullmatch(names[i].lower())])
    controls = controls if len(controls) < len(rest) else []
    rest = [i for i in rest if i not in controls]
    moving = {i: found for i in rest if (found := partner(names, i, rest)) is not None}
    positions = tuple(i for i in rest if i not in moving)
    rates = {position: i for i, (position, _) in moving.items()}
    kinds: list[Kind] = list({kind for _, kind in moving.values()})
    if not rates and SIGHTINGS_ALONE.match(", ".join(names)):
        remedy = f"If these are the coordinates of a system: {SIDECAR[0].lower()}{SIDECAR[1:]}"
        place._replace(column="station").refuse(NO_STATION, ", ".join(names), remedy)
    if not positions:
        place.refuse("position columns", ", ".join(names), SIDECAR)
    if len(kinds) > 1 or len(rates) < len(moving) or not rates.keys() <= {*positions}:
        received = ", ".join(names[i] for i in moving)
        place.refuse("a velocity or a momentum for each position", received, SIDECAR)
    for i in positions:
        if i not in rates and NO_POSITION.fullmatch(names[i].lower()):
            place._replace(column=names[i]).refuse("the name of a position", repr(names[i]), SIDECAR)
        if rates and i not in rates:
            known = ", ".join(names[k] for k in rates.values())
            remedy = f"If it is something else: {SIDECAR[0].lower()}{SIDECAR[1:]}"
            place._replace(column=names[i]).refuse(
                f"{kinds[0]} for all positions, like {known}", "none", remedy
            )
    ordered = tuple(rates[i] for i in positions) if rates else ()
    kind = kinds[0] if kinds else "velocities"
    return Roles(time[0], ids[0] if ids else None, positions, ordered, kind, tuple(controls))


def is_deviation(name: str) -> bool:
    """Return whether a column is, by its name, a standard deviation or a covariance of other columns."""
    return name.lower().startswith((DEVIATIONS, COVARIANCES))


def partner(names: tuple[str, ...], column: int, rest: list[int]) -> tuple[int, Kind] | None:
    """Return the position that belongs to a velocity or momentum column, and its kind; None for a position.

    Names are compared first as written, then in lower case.
    """
    for fold in (str, str.lower):
        own = bare(fold(names[column]))
        for other in rest:
            for kind, known in rates_of(bare(fold(names[other]))).items():
                if other != column and own in known:
                    return other, kind
    return None


def bare(name: str) -> str:
    """Return a name without underscores, with a dot accent written as a suffix."""
    return unicodedata.normalize("NFD", name).replace("\u0307", "dot").replace("_", "")


def rates_of(position: str) -> dict[Kind, set[str]]:
    """Return the possible names of a position's velocity and momentum, without underscores."""
    found: dict[Kind, set[str]] = {kind: {name.format(position) for name in NAMES[kind]} for kind in NAMES}
    if indexed := COORDINATE.fullmatch(position):
        found["velocities"] |= {name.format(indexed["index"]) for name in ("v{}", "vel{}", "velocity{}")}
        found["momenta"] |= {name.format(indexed["index"]) for name in ("p{}", "momentum{}")}
        if indexed["angle"] or indexed["stem"] == "q":
            found["velocities"] |= {name.format(indexed["index"]) for name in OF_ANGLES}
    elif placed := PLACED.fullmatch(position):
        for kind, known in found.items():
            known |= {name.format(placed["of"]) for name in NAMES[kind][:3]}
    return found


def of_sidecar(names: tuple[str, ...], named: dict[str, Any], place: Place) -> dict[str, list[int]]:
    """Return the columns of each role that a sidecar names.

    Raises:
        UserError: an unknown role or column, a column in two roles, or several times or ids.
    """
    found: dict[str, list[int]] = {}
    for role, value in named.items():
        if role not in ROLES:
            place.refuse(f"one of the roles {', '.join(ROLES)}", repr(role) + nearest(role, ROLES))
        columns = [str(v) for v in value] if isinstance(value, list) else [str(value)]
        if role in ROLES[:2] and len(columns) != 1:
            place.refuse(f"one column ({role})", f"{role}: {value}")
        for column in columns:
            if column not in names:
                place.refuse(f"a column {column!r} ({role})", ", ".join(names) + nearest(column, names))
            if any(names.index(column) in known for known in found.values()):
                place._replace(column=column).refuse("one role in the sidecar", f"a second one, {role}")
            found.setdefault(role, []).append(names.index(column))
    return found


def selected(found: dict[str, list[int]], named: dict[str, Any], place: Place) -> Roles:
    """Return the roles of a sidecar that names positions; raises UserError for a missing role or column."""
    kind: Kind = "momenta" if "momenta" in found else "velocities"
    rates, positions = found.get(kind, []), found.get("positions", [])
    if (
        "time" not in found
        or not positions
        or len(rates) not in (0, len(positions))
        or {"velocities", "momenta"} <= found.keys()
    ):
        expected = "columns: time, positions, and equally many velocities or momenta, if it names any of them"
        place.refuse(expected, ", ".join(f"{role}: {named[role]}" for role in named))
    whose, controls = next(iter(found.get("id", [])), None), tuple(found.get("controls", []))
    return Roles(found["time"][0], whose, tuple(positions), tuple(rates), kind, controls)

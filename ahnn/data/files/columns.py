"""What the columns of a file mean: time, trajectory, positions, and velocities or momenta."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

from ahnn.arguments import nearest
from ahnn.data.files.table import Header, Place

TIMES, IDS = ("t", "time"), ("id", "trajectory")
Kind = Literal["velocities", "momenta"]
RATES: dict[str, Kind] = {"v": "velocities", "p": "momenta"}
ROLES = ("time", "id", "positions", "velocities", "momenta")


class Roles(NamedTuple):
    """Numbers of columns.

    Attributes:
        time: of the time.
        id: of what tells trajectories apart; None where there is one.
        positions: of the n positions.
        rates: of the n velocities or momenta, in the order of the positions; none where they are unknown.
        kind: what the rates are.
    """

    time: int
    id: int | None
    positions: tuple[int, ...]
    rates: tuple[int, ...]
    kind: Kind


def roles(header: Header, named: dict[str, Any], place: Place) -> Roles:
    """Return the roles of columns, as a sidecar names them or by their names.

    By name `t` or `time` is the time and `id` or `trajectory` tells trajectories apart; of a position x the
    velocity is `vx` and the momentum `px`, of q1 `v1` and `p1`, of q `v` and `p`. All others are positions.

    Args:
        header: of the file.
        named: from roles to names of columns, as in a sidecar; then other columns are left out.
        place: of the header.

    Raises:
        UserError: a column that is missing, or that has no counterpart.
    """
    names = header.names
    if named:
        return of_sidecar(names, named, place)
    time = [i for i, name in enumerate(names) if name.lower() in TIMES]
    ids = [i for i, name in enumerate(names) if name.lower() in IDS]
    if len(time) != 1 or len(ids) > 1:
        place.refuse(f"one column {' or '.join(TIMES)} and at most one {' or '.join(IDS)}", ", ".join(names))
    rest = [i for i in range(len(names)) if i not in (*time, *ids)]
    partners = {i: partner(names[i], [names[k] for k in rest if k != i]) for i in rest}
    positions = tuple(i for i in rest if partners[i] is None)
    moving = [i for i in rest if partners[i] is not None]
    rates = {partners[i]: i for i in moving}
    kinds: list[Kind] = list({RATES[names[i][0]] for i in moving})
    if not positions:
        place.refuse("columns of positions", ", ".join(names))
    if len(kinds) > 1 or len(rates) < len(moving):
        received = ", ".join(names[i] for i in moving)
        place.refuse("a velocity or a momentum of each position", received, "Name the columns in a sidecar")
    if rates and (alone := [names[i] for i in positions if names[i] not in rates]):
        known = ", ".join(names[i] for i in rates.values())
        remedy = "If it is something else, name the columns in a sidecar"
        place._replace(column=alone[0]).refuse(f"its {kinds[0]} beside {known}", "none", remedy)
    ordered = tuple(rates[names[i]] for i in positions) if rates else ()
    kind: Kind = kinds[0] if kinds else "velocities"
    return Roles(time[0], ids[0] if ids else None, positions, ordered, kind)


def partner(name: str, others: list[str]) -> str | None:
    """Return the position whose velocity or momentum a column is; None for one that stands for itself."""
    if name[0] not in RATES:
        return None
    rest = name[1:].removeprefix("_")
    return next((other for other in (rest, f"q{rest}", f"q_{rest}") if other in others), None)


def of_sidecar(names: tuple[str, ...], named: dict[str, Any], place: Place) -> Roles:
    """Return the roles that a sidecar names.

    Raises:
        UserError: an unknown role or column, or not as many rates as positions.
    """
    found: dict[str, list[int]] = {}
    for role, value in named.items():
        if role not in ROLES:
            place.refuse(f"columns of {', '.join(ROLES)}", repr(role) + nearest(role, ROLES))
        columns = [str(v) for v in value] if isinstance(value, list) else [str(value)]
        for column in columns:
            if column not in names:
                place.refuse(f"a column {column!r} ({role})", ", ".join(names) + nearest(column, names))
        found[role] = [names.index(column) for column in columns]
    single = [len(found.get(role, [])) for role in ("time", "id")]
    kind: Kind = "momenta" if "momenta" in found else "velocities"
    rates = found.get(kind, [])
    positions = found.get("positions", [])
    if (
        single[0] != 1
        or single[1] > 1
        or not positions
        or len(rates) not in (0, len(positions))
        or ({"velocities", "momenta"} <= found.keys())
    ):
        expected = "one time, at most one id, positions, and as many velocities or momenta"
        place.refuse(expected, ", ".join(f"{role}: {named[role]}" for role in named))
    return Roles(
        found["time"][0], next(iter(found.get("id", [])), None), tuple(positions), tuple(rates), kind
    )

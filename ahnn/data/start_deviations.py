"""Standard deviations of states from `sd_NAME` columns of a table."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ahnn.data.files import parquet, sidecar
from ahnn.data.files.columns import DEVIATIONS, roles
from ahnn.data.files.kinds import Kind
from ahnn.data.files.raw import decoded
from ahnn.data.files.reading import bytes_of
from ahnn.data.files.samples import Track, ordered
from ahnn.data.files.sidecar import with_units
from ahnn.data.files.table import read_csv, refuse
from ahnn.data.files.tabular import are_epochs, elapsed, numbers, trajectories, with_clock
from ahnn.data.files.unit_factors import scales

log = logging.getLogger("ahnn")

KINDS = ("table", "parquet")


def deviations_of(path: Path, kind: Kind, times: Tensor, *, weighed: bool) -> Tensor | None:
    """Read the standard deviations of states from a table, in the units and order of its reader.

    Args:
        path: path of the file.
        kind: kind of the file.
        times: (B,) times of the states, one per trajectory.
        weighed: whether a mass is stated.

    Returns:
        (B, 2n); None if the file contains none, or any that is not > 0, as in predictions from exact states.

    Raises:
        UserError: standard deviations of only some components, or in another unit than the components.
    """
    if kind not in KINDS:
        return None
    (raw, aside), beside = bytes_of(path), sidecar.beside(path)
    sheet = (
        parquet.read_parquet(raw, str(path)) if kind == "parquet" else read_csv(decoded(raw, path), str(path))
    )
    said = sidecar.Sidecar() if aside is None else sidecar.parse(decoded(aside, beside), str(beside))
    header = with_units(sheet.header, said, sheet.place)
    found = roles(header, said.columns, sheet.place)
    wanted = (*found.positions, *found.rates)
    names = {k: DEVIATIONS + header.names[k] for k in wanted}
    places = {header.names.index(name): k for k, name in names.items() if name in header.names}
    if not places:
        return None
    lacking = [header.names[k] for k in wanted if k not in places.values()]
    if lacking:
        sheet.place.refuse(f"{DEVIATIONS}{lacking[0]} with the other standard deviations", "none")
    for own, of in places.items():
        if header.units[own] not in (None, header.units[of]):
            at = sheet.place._replace(column=header.names[own])
            at.refuse(f"the unit of {header.names[of]}, {header.units[of]}", f"{header.units[own]}")
    if are_epochs(sheet.columns[found.time]):
        header, clock = with_clock(header, found.time, sheet.place)
        moments, _ = elapsed(sheet, found.time, clock, refuse)
    else:
        moments = numbers(sheet, found.time, refuse)
    by = scales(header, found, sheet.place, weighed=weighed)
    values = np.stack([numbers(sheet, column, refuse) for column in places], axis=1)
    whole = Track("", str(path), sheet.rows, moments * by.time, values * (*by.positions, *by.rates))
    time = header.names[found.time]
    tracks = [ordered(track, time) for track in trajectories(sheet, found.id, whole, refuse)]
    pairs = zip(tracks, times.tolist(), strict=True)
    chosen = np.stack([track.values[np.abs(track.times - moment).argmin()] for track, moment in pairs])
    if not np.isfinite(chosen).all() or not (chosen > 0.0).all():
        log.warning("start %s: the standard deviations are not used, since not all of them are > 0", path)
        return None
    return torch.from_numpy(chosen)

"""Covariances of states from the columns `cov_NAME_NAME` of a table, or else from its columns `sd_NAME`."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ahnn.data.files.columns import COVARIANCES, DEVIATIONS, roles
from ahnn.data.files.kinds import TABLES, Kind
from ahnn.data.files.reading import bytes_of, table_of
from ahnn.data.files.table import Header, Place
from ahnn.data.files.tabular import tracks_of
from ahnn.data.files.units import product, unit

log = logging.getLogger("ahnn")


def table_covariances(path: Path, kind: Kind, times: Tensor) -> Tensor | None:
    """Read the covariances of states from a table, in the units and order of its reader.

    Args:
        path: path of the file.
        kind: kind of the file.
        times: (B,) times of the states, one per trajectory.

    Returns:
        (B, 2n, 2n), diagonal if the table has only standard deviations; None if the file contains neither, or
        any standard deviation that is not > 0, as in predictions from exact states.

    Raises:
        UserError: columns of only some components, or in another unit than the components.
    """
    if kind not in TABLES:
        return None
    sheet, said = table_of(path, *bytes_of(path), kind)
    header = sheet.header
    found = roles(header, said.columns, sheet.place)
    wanted = (*found.positions, *found.rates)
    pairs = covariance_columns(header, wanted, sheet.place)
    deviations = {} if pairs else deviation_columns(header, wanted, sheet.place)
    if not (pairs or deviations):
        return None
    table = tracks_of(sheet, found, (*pairs, *deviations))
    each = zip(table.tracks, times.tolist(), strict=True)
    chosen = np.stack([track.values[np.abs(track.times - moment).argmin()] for track, moment in each])
    matrices = np.zeros((len(chosen), len(wanted), len(wanted)))
    for k, (i, j) in enumerate(pairs.values()):
        matrices[:, i, j] = matrices[:, j, i] = chosen[:, k]
    for k, i in enumerate(deviations.values()):
        matrices[:, i, i] = np.square(chosen[:, k]) * (chosen[:, k] > 0.0)
    if not np.isfinite(matrices).all() or not (np.diagonal(matrices, axis1=1, axis2=2) > 0.0).all():
        log.warning("start %s: the standard deviations are not used, since not all of them are > 0", path)
        return None
    factors = np.array((*table.by.positions, *table.by.rates))
    return torch.from_numpy(matrices * np.outer(factors, factors))


def covariance_columns(header: Header, wanted: tuple[int, ...], place: Place) -> dict[int, tuple[int, int]]:
    """Return the pair of components of each column of a covariance; {} without any.

    Raises:
        UserError: a missing column, or one in another unit than the product of those of its components.
    """
    found = {}
    pairs = [(i, j) for i in range(len(wanted)) for j in range(i + 1)]
    names = [f"{COVARIANCES}{header.names[wanted[i]]}_{header.names[wanted[j]]}" for i, j in pairs]
    if not set(names) & set(header.names):
        return {}
    for name, (i, j) in zip(names, pairs, strict=True):
        if name not in header.names:
            place.refuse(f"{name} with the other covariances", "none")
        column = header.names.index(name)
        own, parts = header.units[column], [header.units[wanted[k]] or "1" for k in (i, j)]
        if own is not None and not _alike(own, expected := product(*parts)):
            of = " and ".join(dict.fromkeys(header.names[wanted[k]] for k in (i, j)))
            place._replace(column=name).refuse(f"the unit of {of}, {expected}", own)
        found[column] = i, j
    return found


def _alike(own: str, expected: str) -> bool:
    """Return whether two texts are the same unit; names of other units are compared as texts."""
    try:
        a, b = unit(own), unit(expected)
    except ValueError:
        return own == expected
    return a.dimension == b.dimension and math.isclose(a.size, b.size, rel_tol=1e-12)


def deviation_columns(header: Header, wanted: tuple[int, ...], place: Place) -> dict[int, int]:
    """Return the component of each column of standard deviations; {} without any.

    Raises:
        UserError: a missing column, or one in another unit than its component.
    """
    names = [DEVIATIONS + header.names[k] for k in wanted]
    places = {header.names.index(name): i for i, name in enumerate(names) if name in header.names}
    if not places:
        return {}
    if lacking := [name for i, name in enumerate(names) if i not in places.values()]:
        place.refuse(f"{lacking[0]} with the other standard deviations", "none")
    for own, i in places.items():
        of = wanted[i]
        if header.units[own] not in (None, header.units[of]):
            at = place._replace(column=header.names[own])
            at.refuse(f"the unit of {header.names[of]}, {header.units[of]}", f"{header.units[own]}")
    return places

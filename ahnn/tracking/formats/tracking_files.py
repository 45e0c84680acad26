"""Reading of tracking data in any supported format, detected by content."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ahnn.data.files.kinds import ABOUT, Kind, kind_of
from ahnn.data.files.raw import content_of, decoded
from ahnn.data.files.table import Note, Place, Remark, refuse
from ahnn.tracking.formats.crd import crd_data
from ahnn.tracking.formats.sighting_columns import columns_data, has_columns
from ahnn.tracking.formats.station_table import table_data
from ahnn.tracking.formats.tdm import tdm_data
from ahnn.tracking.formats.tracking_sidecar import sidecar_of
from ahnn.tracking.tracking_data import KINDS, TrackingData

READABLE: tuple[Kind, ...] = ("tdm", "crd", "station_table")
NEAREST, FARTHEST = 100.0, 1e6
"""Ranges of Earth satellites in km: no orbit is lower, and none reaches beyond the Earth's attraction."""


def read_tracking(
    path: str | Path, aside: str | Path | None = None, note: Note = refuse
) -> list[TrackingData]:
    """Read the measurements of a file, by satellite and time-tagged event.

    Args:
        path: path of a TDM in either notation, of normal points (CRD), or of a plain table.
        aside: path of the sidecar; None for the YAML file of the same name, if present.
        note: callback for damaged content, which is then skipped, and for ranges in an implausible unit.

    Raises:
        UserError: an unsupported format, named in the message, or a fault raised by `note`.
    """
    path = Path(path)
    found = parsed(path, aside, note)
    for data in found:
        for remark in implausible_ranges(data, str(path)):
            note(remark)
    return found


def parsed(path: Path, aside: str | Path | None, note: Note) -> list[TrackingData]:
    """Read the measurements of a file, see `read_tracking`."""
    raw, file = content_of(path), str(path)
    kind = kind_of(raw, file)
    if kind == "table" and has_columns(decoded(raw, path)):
        kind = "station_table"  # without stations, which the reader reports
    if kind not in READABLE:
        Place(file).refuse(" or ".join(ABOUT[one] for one in READABLE), ABOUT[kind])
    text, said = decoded(raw, path), sidecar_of(path, None if aside is None else Path(aside))
    if kind == "crd":
        return crd_data(text, file, note)
    if kind == "tdm":
        return tdm_data(text, file, said.two_way, note)
    return (columns_data if has_columns(text) else table_data)(text, file, said, note)


def implausible_ranges(data: TrackingData, file: str) -> Iterator[Remark]:
    """Yield a warning for each station whose typical range, in km, is not that of an Earth satellite."""
    ranges = data.values[:, KINDS.index("range")]
    for k, name in enumerate(data.stations):
        own = ranges[(data.station == k) & np.isfinite(ranges)]
        typical = float(np.median(own)) if len(own) else NEAREST
        if NEAREST <= typical <= FARTHEST:
            continue
        what = f"ranges of {name} of typically {typical:,.4g} km, not those of an Earth satellite"
        mistake = "metres given as km?" if typical > FARTHEST else "kilometres given as m?"
        yield Remark(Place(file, column="range"), what, f"Correct the unit: {mistake}", "warning")

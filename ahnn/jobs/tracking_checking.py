"""Check of tracking data, station coordinates and Earth orientation files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table

from ahnn.data.doctor import Finding
from ahnn.data.doctor.finding import is_consequence
from ahnn.data.doctor.spans import duration
from ahnn.data.files import epochs
from ahnn.data.files.kinds import ABOUT, kind_of
from ahnn.data.files.raw import content_of, decoded
from ahnn.data.files.table import Fault, Place, Remark
from ahnn.evaluation.data_findings import counted, listed
from ahnn.jobs.tracking_figures import draw
from ahnn.tracking.formats.bulletin_b import read_bulletins
from ahnn.tracking.formats.sinex import sinex_stations
from ahnn.tracking.formats.tracking_files import READABLE, read_tracking
from ahnn.tracking.survey import SeriesSurvey, survey
from ahnn.tracking.tracking_data import EVENTS, TrackingData

LISTED = 20
"""Maximum number of listed outliers per series."""


def tracking_check(path: Path, figures: Path | None = None) -> tuple[list[Finding], RenderableType]:
    """Return the defects of a file, and a summary.

    Args:
        path: path of the file.
        figures: folder for figures of the measurements, or None.

    Raises:
        UserError: the file is missing, or a figure cannot be written.
    """
    kind = kind_of(content_of(path), str(path))
    said: list[Fault | Remark] = []
    shown: list[RenderableType] = []
    found: list[Finding] = []
    try:
        if kind in READABLE:
            surveys = [(data, survey(data)) for data in read_tracking(path, note=said.append)]
            for data, series in surveys:
                shown.append(_table(path, data, series))
                found += _findings(path, data, series)
            if figures is not None:
                draw(path, surveys, figures)
        else:
            holds, unused = (_stations if kind == "sinex" else _days)(path)
            shown.append(f"{path.name}: {holds}")
            said.append(Remark(Place(str(path)), f"not used: {unused}"))
    except Fault as fault:
        if not is_consequence(fault, said):
            said.append(fault)
    found = [*map(Finding.of, said), *found]
    body = [*shown, ""] if shown else []
    findings = [listed(found), ""] if found else []
    return found, Group(*body, *findings, f"{path.name}, {ABOUT[kind]}: {counted(found)}")


def _stations(path: Path) -> tuple[str, str]:
    """Summarise a SINEX file and its unused content."""
    found = sinex_stations(decoded(content_of(path), path), str(path))
    holds = f"station positions: {len(found.solutions)}, eccentricities: {len(found.eccentricities)}"
    return holds, ", ".join(found.unused) or "nothing"


def _days(path: Path) -> tuple[str, str]:
    """Summarise a Bulletin B and its unused content."""
    found = read_bulletins(path)
    last = found.mjd[found.final][-1] if found.final.any() else float("nan")
    ends = f"MJD {found.mjd[0]:.0f} to {found.mjd[-1]:.0f}, final until {last:.0f}"
    holds = f"polar motion and UT1 - UTC for {len(found.mjd)} days, {ends}"
    return holds, "standard deviations, and sections after the first"


def _table(path: Path, data: TrackingData, series: list[SeriesSurvey]) -> RenderableType:
    """Format a table of stations, kinds, times and numbers of measurements."""
    whose = f"satellite {data.object}" if data.object else "an unnamed satellite"
    head = (
        f"{path.name}: {len(data.times)} measurements of {whose}, with times of {EVENTS[data.event]} in UTC"
    )
    table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False)
    for name in ("station", "kind", "count", "passes", "from", "to", "longest gap"):
        table.add_column(name, justify="left" if name in ("station", "kind", "from", "to") else "right")
    for one in series:
        ends = (_spelled(data, float(one.times[k]))[:16] for k in (0, -1))
        kind_of_it, gap = one.kind.replace("_", " "), duration(one.gap)
        table.add_row(one.station, kind_of_it, str(len(one.times)), str(one.passes), *ends, gap)
    return Group(head, table)


def _spelled(data: TrackingData, time: float) -> str:
    return epochs.spelled(data.epoch + round(time * epochs.SECOND), utc=True)


def _findings(path: Path, data: TrackingData, series: list[SeriesSurvey]) -> list[Finding]:
    """Return findings on outliers and unused content."""
    found = [Finding("note", str(path), 0, "", one, "Nothing") for one in data.remarks]
    for one in series:
        for places, what, remedy in (
            (one.outliers, "far from its neighbours", "Leave it out if its residual confirms this"),
            (one.impossible, "the range changes faster than a satellite can move", "Check time and range"),
        ):
            for k in np.asarray(places)[:LISTED]:
                text = f"{one.station} at {_spelled(data, float(one.times[k]))[:19]}: {what}"
                row, name = int(one.rows[k]), one.kind.replace("_", " ")
                found.append(Finding("warning", str(path), row, name, text, remedy))
    return found

"""Atomic output of predictions, in a format chosen by the file extension."""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from pathlib import Path

from ahnn.data.files import sidecar
from ahnn.data.files.messages import SUFFIXES as MESSAGES
from ahnn.data.files.messages import write_oem
from ahnn.data.files.parquet import packed_table
from ahnn.data.starts import Starts
from ahnn.errors import UserError
from ahnn.files import write_atomically
from ahnn.manifest import require_own
from ahnn.prediction.beginning import beginning
from ahnn.prediction.ephemeris_message import ephemerides
from ahnn.prediction.prediction_table import as_csv, columns, described
from ahnn.prediction.propagation import Prediction
from ahnn.types import Space

log = logging.getLogger(__name__)
SUFFIXES = (".csv", ".parquet", ".oem", ".xml")
PICTURES = (".png", ".svg")
UNSAFE = re.compile(r"[^A-Za-z0-9_.-]+")
"""Characters of an identifier that are replaced in the name of a file."""


def require_output(path: Path, starts: Starts, space: Space) -> None:
    """Check, before any computation, that the output file can be written.

    Raises:
        UserError: unknown extension, missing folder, or an ephemeris message for states that are not an orbit
            with an epoch.
    """
    if path.suffix.lower() not in SUFFIXES or not path.parent.is_dir() or path.is_dir():
        message = f"output: expected {_file_of(SUFFIXES)}; received {path}"
        raise UserError(message)
    if path.suffix.lower() in MESSAGES:
        require_own(messages(path, starts), "output")
        nothing = Prediction(starts.times[:1], starts.states.unsqueeze(1))
        ephemerides(nothing, starts, space)
    else:
        require_own([path], "output")
        sidecar.require_place(path)


def messages(path: Path, starts: Starts) -> dict[Path, list[int]]:
    """Return the files of ephemeris messages with the trajectories of each: a message has one object.

    Those of several objects have the identifier in their name (CCSDS 502.0-B, 5.1: a single object).

    Raises:
        UserError: two identifiers give the same file.
    """
    objects: dict[str, list[int]] = {}
    for b, one in enumerate(starts.objects):
        objects.setdefault(one.id, []).append(b)
    if len(objects) == 1:
        return {path: [*range(len(starts.objects))]}
    found: dict[Path, list[int]] = {}
    for name, rows in objects.items():
        place = path.with_name(f"{path.stem}_{UNSAFE.sub('_', name)}{path.suffix}")
        if place in found:
            message = f"output: expected objects whose files differ; received two for {place}. Write a table"
            raise UserError(message)
        found[place] = rows
    return found


def _file_of(suffixes: tuple[str, ...]) -> str:
    """Describe a valid output file, for messages."""
    return f"a {', '.join(suffixes[:-1])} or {suffixes[-1]} file in an existing folder"


def require_other(path: Path, start: Path) -> None:
    """Raise UserError if a prediction would overwrite its own start."""
    if path.exists() and start.exists() and path.samefile(start):
        message = f"output: expected a file other than the start; received {path} for both"
        raise UserError(message)


def write(
    path: Path,
    prediction: Prediction,
    starts: Starts,
    space: Space,
    remarks: Sequence[str] = (),
    *,
    correlated: bool = False,
) -> None:
    """Write a prediction.

    Args:
        path: path of the file.
        prediction: prediction to write.
        starts: names, times and reference of the starts.
        space: description of the state components.
        remarks: remarks on its bands, written as comments into the message or the sidecar.
        correlated: whether tables contain the covariances too, as messages do.

    Raises:
        UserError: see `require_output`; or Parquet without pyarrow.
    """
    suffix = path.suffix.lower()
    if suffix in MESSAGES:
        segments, places = ephemerides(prediction, starts, space), messages(path, starts)
        for place, rows in places.items():
            write_oem(place, [segments[b] for b in rows], comments=remarks)
        if len(places) > 1:
            log.info("output: %d messages, one for each object, such as %s", len(places), next(iter(places)))
        return
    if starts.reference.epoch is not None:
        zero = starts.reference.spelled()
        remarks = [*remarks, f"t is counted from {zero} {starts.reference.clock}".rstrip()]
    found = columns(prediction, starts, space, correlated=correlated)
    write_atomically(path, as_csv(found) if suffix == ".csv" else packed_table(found))
    sidecar.write(path, described(starts, space), remarks)


def require_figure(path: Path) -> None:
    """Raise UserError for a figure that cannot be written."""
    if path.suffix.lower() not in PICTURES or not path.parent.is_dir():
        message = f"figure: expected {_file_of(PICTURES)}; received {path}"
        raise UserError(message)
    require_own([path], "figure")


def draw(path: Path, prediction: Prediction, starts: Starts, space: Space, title: str) -> None:
    """Draw and write the figure of a prediction."""
    from ahnn.evaluation.sinks.figure_files import drawn
    from ahnn.prediction.figure import prediction_figure

    about = beginning(prediction, starts, space.units.time, "\n")  # titles are narrow
    figure = prediction_figure(prediction, space, title, about)
    write_atomically(path, drawn(figure, path.suffix.lower()))

"""Atomic output of predictions, in a format chosen by the file extension."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ahnn.data.files import sidecar
from ahnn.data.files.messages import SUFFIXES as MESSAGES
from ahnn.data.files.messages import write_oem
from ahnn.data.starts import Starts
from ahnn.errors import UserError
from ahnn.files import write_atomically
from ahnn.manifest import require_own
from ahnn.prediction.beginning import beginning
from ahnn.prediction.ephemeris_message import ephemerides
from ahnn.prediction.prediction_table import as_csv, as_parquet, columns, described
from ahnn.prediction.propagation import Prediction
from ahnn.types import Space

SUFFIXES = (".csv", ".parquet", ".oem", ".xml")
PICTURES = (".png", ".svg")


def require_output(path: Path, starts: Starts, space: Space) -> None:
    """Check, before any computation, that the output file can be written.

    Raises:
        UserError: unknown extension, missing folder, or an ephemeris message for states that are not an orbit
            with an epoch.
    """
    if path.suffix.lower() not in SUFFIXES or not path.parent.is_dir() or path.is_dir():
        message = f"output: expected {_file_of(SUFFIXES)}; received {path}"
        raise UserError(message)
    require_own([path], "output")
    if path.suffix.lower() in MESSAGES:
        nothing = Prediction(starts.times[:1], starts.states.unsqueeze(1))
        ephemerides(nothing, starts, space)
    else:
        sidecar.require_place(path)


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
        write_oem(path, ephemerides(prediction, starts, space), comments=remarks)
        return
    found = columns(prediction, starts, space, correlated=correlated)
    write_atomically(path, as_csv(found) if suffix == ".csv" else as_parquet(found))
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

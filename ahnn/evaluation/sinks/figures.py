"""The figures as files: PNG to look at, SVG to print."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from matplotlib import rc_context
from matplotlib.figure import Figure

from ahnn.evaluation.case import Findings
from ahnn.evaluation.results import Results
from ahnn.files import write_atomically
from ahnn.progress import track

DPI = 150
FORMATS: dict[str, dict[str, Any]] = {
    ".png": {"dpi": DPI},
    ".svg": {"dpi": DPI, "metadata": {"Date": None}},  # the same figure is the same file
}


@final
@dataclass(frozen=True)
class FigureSink:
    """Writes the figures into a folder that holds no others.

    Attributes:
        folder: of the evaluation; pictures of an earlier one in `folder/figures` are removed.
    """

    folder: Path

    def __call__(self, results: Results, findings: Findings) -> None:  # noqa: ARG002
        """Write every figure in each format; a picture that is a link is replaced, never followed."""
        folder = self.folder / "figures"
        clear(folder)
        figures = findings.figures
        for name, figure in track(figures.items(), "drawing figures", len(figures)):
            for suffix, options in FORMATS.items():
                content = drawn(figure, suffix, options)
                write_atomically(folder / f"{name.replace('/', '_')}{suffix}", content)


def clear(folder: Path) -> None:
    """Remove the pictures in a folder; of a link, the link alone."""
    if folder.is_symlink():
        folder.unlink()
    for path in folder.iterdir() if folder.is_dir() else ():
        if path.suffix in FORMATS and (path.is_symlink() or path.is_file()):
            path.unlink()


def drawn(figure: Figure, suffix: str, options: dict[str, Any]) -> bytes:
    """Return a figure as the content of a file."""
    buffer = io.BytesIO()
    with rc_context({"svg.hashsalt": "ahnn"}):
        figure.savefig(buffer, format=suffix[1:], **options)
    figure.set_layout_engine()  # the places of its parts are found: any engine would draw once more to look
    return buffer.getvalue()

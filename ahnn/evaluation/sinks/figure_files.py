"""Figure files: PNG for viewing, SVG for printing, PDF for LaTeX."""

from __future__ import annotations

import io
import logging
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

from matplotlib import rc_context
from matplotlib.figure import Figure

from ahnn.files import write_atomically
from ahnn.manifest import own_folder, remove_own
from ahnn.progress import track

DPI = 150
FORMATS: dict[str, dict[str, Any]] = {
    ".png": {"dpi": DPI},
    ".svg": {"dpi": DPI, "metadata": {"Date": None}},  # reproducible files
}
PRINTED = FORMATS | {".pdf": {"dpi": DPI, "metadata": {"CreationDate": None}}}
"""Formats of a report; a PDF takes as long as a PNG, so figures of runs are written without it."""
logging.getLogger("fontTools").setLevel(logging.WARNING)  # a PDF would log fifty lines about its fonts
_DRAWN: WeakKeyDictionary[Figure, dict[str, bytes]] = WeakKeyDictionary()


def write_figures(folder: Path, figures: Mapping[str, Figure]) -> None:
    """Write figures in each format to `folder/figures`, after removing earlier ones from there.

    Args:
        folder: folder of the evaluation.
        figures: figures by name.
    """
    folder = own_folder(folder / "figures")
    clear(folder)
    for name, figure in track(figures.items(), "drawing figures", len(figures)):
        for suffix in FORMATS:
            write_atomically(folder / f"{name.replace('/', '_')}{suffix}", drawn(figure, suffix))


def clear(folder: Path) -> None:
    """Remove the figures that `ahnn` wrote from a folder."""
    for path in pictures_in(folder):
        remove_own(path)


def pictures_in(folder: Path, formats: Iterable[str] = tuple(FORMATS)) -> list[Path]:
    """Return the files of a folder with names of figures in some formats, of any origin."""
    return sorted(p for p in folder.iterdir() if p.suffix in formats) if folder.is_dir() else []


def drawn(figure: Figure, suffix: str) -> bytes:
    """Return a figure as file content; each format is drawn once for all outputs."""
    contents = _DRAWN.setdefault(figure, {})
    if suffix not in contents:
        figure.align_ylabels()
        buffer = io.BytesIO()
        # Many journals reject fonts of type 3, the default in PDF.
        with rc_context({"svg.hashsalt": "ahnn", "pdf.fonttype": 42}):
            figure.savefig(buffer, format=suffix[1:], **PRINTED[suffix])
        figure.set_layout_engine()  # a layout engine would draw once more, although the layout is fixed
        contents[suffix] = buffer.getvalue()
    return contents[suffix]

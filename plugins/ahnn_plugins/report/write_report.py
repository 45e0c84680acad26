"""Generation of the complete report from runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, final

from ahnn.arguments import Within, checked
from ahnn.evaluation.sinks.figure_files import PRINTED, pictures_in
from ahnn.files import claimed, require_writable, write_atomically
from ahnn.manifest import remove_own, require_folder
from ahnn.optional_libraries import library
from ahnn_plugins.report import many, single
from ahnn_plugins.report.collection import Collection, collect
from ahnn_plugins.report.document import page
from ahnn_plugins.report.grid import Grid
from ahnn_plugins.report.layout import grid_latex
from ahnn_plugins.report.markdown import grid_markdown
from ahnn_plugins.report.markup import safe_name
from ahnn_plugins.report.pictures import Picture, pictures
from ahnn_plugins.report.spreadsheet import scores_csv

FILE = "report.html"
FOLDERS = ("figures", "tables")


@final
@checked
@dataclass(frozen=True, kw_only=True)
class Report:
    """Writer of report.html, tables.csv, tables/*.tex and *.md, and figures/*.png, *.svg, *.pdf.

    Attributes:
        confidence: confidence level of rankings and claims.
        figures: whether to draw figures.
    """

    confidence: Annotated[float, Within(above=0.5, below=1)] = 0.95
    figures: bool = True

    def __call__(self, folders: Sequence[Path], output: Path) -> str:
        """Report on runs and return a one-line summary of the output.

        All content is generated before anything is written; files of an earlier report are removed.

        Args:
            folders: runs, or folders of runs.
            output: report folder, new or of an earlier report.

        Raises:
            UserError: no runs, a damaged run, an output folder with other content, or plotly is missing.
        """
        if self.figures:
            library("plotly", "plotly", "report", "figures, unless report.figures=false")
        files = (output / FILE, output / "tables.csv", *earlier(output))
        require_folder(output, "output", files, FOLDERS)
        collection = collect(folders)
        drawings = pictures(collection) if self.figures else []
        contents = self._files(collection, drawings)
        require_writable(output)
        with claimed(output):
            clear_earlier(output)
            for name, content in contents.items():
                write_atomically(output / name, content)
        megabytes = len(contents[FILE]) / 1e6
        count = f"{len(collection.entries)} run" + "s" * (len(collection.entries) != 1)
        return f"{count}, {len(drawings)} figures: {output / FILE} ({megabytes:.1f} MB)"

    def _files(self, collection: Collection, drawings: list[Picture]) -> dict[str, bytes]:
        """Return the contents of all files by name, the self-contained page first."""
        from ahnn_plugins.report import interactive

        is_single = len(collection.entries) == 1
        if is_single:
            grids = single.tables(collection)
            parts = single.sections(collection, grids, drawings)
        else:
            grids = many.tables(collection, self.confidence)
            parts = many.sections(collection, grids, drawings, self.confidence)
            grids = many.with_claims(collection, grids, self.confidence)
        title, subtitle = headings(collection)
        text = page(title, subtitle, parts, interactive.library() if drawings else "")
        files = {FILE: text.encode("utf-8", "replace")}
        files["tables.csv"] = scores_csv(collection).encode("utf-8", "replace")
        for name, grid in named(grids).items():
            files[f"tables/{name}.tex"] = grid_latex(grid).encode("utf-8", "replace")
            files[f"tables/{name}.md"] = grid_markdown(grid).encode("utf-8", "replace")
        for drawing in drawings:
            for suffix, content in drawing.files.items():
                files[f"figures/{safe_name(drawing.drawing.name)}{suffix}"] = content
        return files


def headings(collection: Collection) -> tuple[str, str]:
    """Return title and subtitle."""
    entries = collection.entries
    if len(entries) == 1:
        (entry,) = entries
        return f"{entry.model} on {entry.system}", str(entry.folder)
    dates = sorted({str(e.results.about["date"])[:10] for e in entries if "date" in e.results.about})
    when = f", trained {dates[0]}" + (f" to {dates[-1]}" if len(dates) > 1 else "") if dates else ""
    *first, last = collection.systems()
    systems = f"{', '.join(first)} and {last}" if first else last
    return f"{len(entries)} runs on {systems}", f"Scores over seeds{when}"


def named(grids: dict[str, list[Grid]]) -> dict[str, Grid]:
    """Return tables by unique file names."""
    found: dict[str, Grid] = {}
    for grid in (grid for each in grids.values() for grid in each):
        name = base = safe_name(grid.name)
        number = 1
        while name in found:
            number += 1
            name = f"{base}_{number}"
        found[name] = grid
    return found


def clear_earlier(output: Path) -> None:
    """Remove tables and figures of an earlier report."""
    for path in earlier(output):
        remove_own(path)


def earlier(output: Path) -> list[Path]:
    """Return the tables and figures in a report folder, of any origin."""
    tables = output / "tables"
    found = [p for p in tables.iterdir() if p.suffix in (".tex", ".md")] if tables.is_dir() else []
    return [*pictures_in(output / "figures", PRINTED), *sorted(found)]

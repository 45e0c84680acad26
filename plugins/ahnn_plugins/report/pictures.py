"""Figures of a report: as HTML in the page, and as separate files."""

from __future__ import annotations

from typing import NamedTuple

from ahnn.evaluation.sinks.figure_files import PRINTED, drawn
from ahnn.progress import track
from ahnn_plugins.report.collection import Collection
from ahnn_plugins.report.drawing import Drawing
from ahnn_plugins.report.markup import Markup, escaped, safe_name, tag


class Picture(NamedTuple):
    """A figure with its HTML and its files.

    Attributes:
        drawing: figure data.
        html: element with its script.
        files: file contents by suffix.
    """

    drawing: Drawing
    html: Markup
    files: dict[str, bytes]


def pictures(collection: Collection) -> list[Picture]:
    """Return all figures of a collection, without plotly.js itself."""
    from ahnn_plugins.report.figures import draw
    from ahnn_plugins.report.interactive import to_html
    from ahnn_plugins.report.static import to_matplotlib

    drawings = draw(collection)
    made = []
    for drawing in track(drawings, "drawing figures", len(drawings)):
        figure = to_matplotlib(drawing)
        files = {suffix: drawn(figure, suffix) for suffix in PRINTED}
        made.append(Picture(drawing, Markup(to_html(drawing)), files))
    return made


def figures_html(found: list[Picture]) -> Markup:
    """Return figures with titles and captions."""
    return escaped([_figure(picture) for picture in found])


def _figure(picture: Picture) -> Markup:
    drawing = picture.drawing
    parts = (
        tag("h4", drawing.title),
        tag("div", picture.html, class_="drawing"),
        tag("figcaption", f"{drawing.spread} {drawing.caption}".strip()),
    )
    return tag("figure", *parts, id=f"figure-{safe_name(drawing.name)}")


def of_system(found: list[Picture], systems: list[str]) -> dict[str, list[Picture]]:
    """Group figures by the longest system name with which their name begins; "" if there is none."""
    from ahnn_plugins.report.figures.task import file_name

    names, placed = {s: file_name(s) for s in systems}, dict[str, list[Picture]]()
    for picture in found:
        fits = [s for s, name in names.items() if picture.drawing.name.startswith(f"{name}_")]
        placed.setdefault(max(fits, key=lambda s: len(names[s]), default=""), []).append(picture)
    return placed

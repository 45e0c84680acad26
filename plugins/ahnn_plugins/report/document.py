"""Offline HTML file: sections with table of contents, style and scripts."""

from __future__ import annotations

from importlib.resources import files
from typing import NamedTuple

from ahnn_plugins.report.markup import Markup, escaped, tag

POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline' 'unsafe-eval'; "
    "img-src data: blob:; font-src data:; worker-src blob:"
)
"""Content security policy of the page: no external content. Plotly needs eval to compile shaders."""

OPEN_FOR_PRINT = """
addEventListener("beforeprint", () => {
  for (const each of document.querySelectorAll("details:not([open])")) {
    each.open = true;
    each.dataset.shut = "";
  }
});
addEventListener("afterprint", () => {
  for (const each of document.querySelectorAll("details[data-shut]")) {
    each.open = false;
    delete each.dataset.shut;
  }
});
if (matchMedia("(min-width: 75rem)").matches) document.querySelector("nav details").open = true;
"""


class Section(NamedTuple):
    """Section of the page.

    Attributes:
        anchor: anchor name.
        title: heading.
        body: content below the heading.
        parts: subsections.
    """

    anchor: str
    title: str
    body: Markup = Markup()
    parts: tuple[Section, ...] = ()


def page(title: str, subtitle: str, sections: list[Section], library: str = "") -> str:
    """Return the complete file.

    Args:
        title: title of the window and the page.
        subtitle: line below the title.
        sections: sections in order.
        library: source of plotly.js and the renderer; "" without interactive figures.
    """
    style = files("ahnn_plugins.report").joinpath("page.css").read_text("utf-8")
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=POLICY),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="color-scheme", content="light dark"),
        tag("title", title),
        tag("style", Markup(style)),
        tag("script", Markup(library)) if library else [],
    )
    contents = tag(
        "nav", tag("details", tag("summary", "Contents"), _contents(sections)), aria_label="Contents"
    )
    header = tag("header", tag("h1", title), tag("p", subtitle))
    main = tag("main", [_section(section, 2) for section in sections])
    body = tag(
        "body", header, tag("div", contents, main, class_="page"), tag("script", Markup(OPEN_FOR_PRINT))
    )
    return "<!doctype html>\n" + tag("html", head, body, lang="en") + "\n"


def _contents(sections: list[Section] | tuple[Section, ...]) -> Markup:
    items = [
        tag("li", tag("a", s.title, href=f"#{s.anchor}"), _contents(s.parts) if s.parts else [])
        for s in sections
    ]
    return tag("ol", items)


def _section(section: Section, level: int) -> Markup:
    link = tag("a", section.title, href=f"#{section.anchor}")
    parts = [_section(part, level + 1) for part in section.parts]
    return tag("section", tag(f"h{level}", link), escaped([section.body, *parts]), id=section.anchor)

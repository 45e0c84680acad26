"""One HTML file that needs no network: sections with their table of contents, style and scripts inside."""

from __future__ import annotations

from importlib.resources import files
from typing import NamedTuple

from ahnn_plugins.report.markup import Markup, escaped, tag

POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline' 'unsafe-eval'; "
    "img-src data: blob:; font-src data:; worker-src blob:"
)
"""What the page may load: nothing but what stands in it. Plotly compiles its shaders' code."""

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
    """A part of the page.

    Attributes:
        anchor: its name in addresses.
        title: its heading.
        body: what stands below the heading.
        parts: sections in it.
    """

    anchor: str
    title: str
    body: Markup = Markup()
    parts: tuple[Section, ...] = ()


def page(title: str, subtitle: str, sections: list[Section], library: str = "") -> str:
    """Return the whole file.

    Args:
        title: of the window and the page.
        subtitle: a line below it.
        sections: in their order.
        library: source of plotly.js; "" where no figure needs it.
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

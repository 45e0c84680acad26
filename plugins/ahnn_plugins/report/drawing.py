"""A figure as data: what is drawn, apart from how; one renderer makes it interactive, another static."""

from __future__ import annotations

from typing import Literal, NamedTuple

from torch import Tensor

Role = Literal["model", "truth", "floor", "filter", "measurement", "paper"]
Kind = Literal["lines", "orbit", "bars"]


class Series(NamedTuple):
    """A curve.

    Attributes:
        label: in the legend; series of one label are switched on and off together.
        x, y: values, (T,).
        z: third coordinate of an orbit, (T,).
        role: what it is, which decides colour and line together with the label.
        low, high: a band about it, (T,).
        hover: further values to show under the pointer, by name with unit, each (T,).
    """

    label: str
    x: Tensor
    y: Tensor
    z: Tensor | None = None
    role: Role = "model"
    low: Tensor | None = None
    high: Tensor | None = None
    hover: dict[str, Tensor] = {}  # noqa: RUF012 - never written to


class Panel(NamedTuple):
    """Axes with curves; labels hold their units."""

    series: tuple[Series, ...]
    x: str
    y: str
    z: str = ""
    log: bool = False


class Drawing(NamedTuple):
    """A figure of a report.

    Attributes:
        name: of its files and its anchor, such as `molniya_orbits`.
        title: one line.
        caption: what it shows and of which runs, with the figure of the paper that it answers to.
        panels: one below another.
        kind: `lines`; `orbit`, in three dimensions; or `bars`.
    """

    name: str
    title: str
    caption: str
    panels: tuple[Panel, ...]
    kind: Kind = "lines"

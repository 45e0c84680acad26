"""A figure as data: what is drawn, apart from how; one renderer makes it interactive, another static."""

from __future__ import annotations

from typing import Literal, NamedTuple

from torch import Tensor

Role = Literal["model", "truth", "floor", "filter", "measurement", "paper", "term"]
Kind = Literal["lines", "orbit", "bars"]


class Series(NamedTuple):
    """A curve, or the dots of one thing that is compared.

    Attributes:
        label: in the legend; series of one label are switched on and off together.
        x, y: values, (T,); NaN interrupts a curve.
        z: third coordinate of an orbit, (T,).
        role: what it is. A `filter` is a model that assimilates, a `term` a part of a sum.
        slot: the number of its model in the report, or of its term; role and slot decide colour and dash, so
            that a model looks the same in every figure.
        low, high: a band about it, (T,); of dots, their spread.
        hover: further values to show under the pointer, by name with unit, each (T,).
    """

    label: str
    x: Tensor
    y: Tensor
    z: Tensor | None = None
    role: Role = "model"
    slot: int = 0
    low: Tensor | None = None
    high: Tensor | None = None
    hover: dict[str, Tensor] = {}  # noqa: RUF012 - never written to


class Panel(NamedTuple):
    """Axes with curves.

    Attributes:
        series: what is drawn, the first below.
        x, y, z: labels, with their units.
        log: whether the vertical axis is logarithmic.
        equal: whether a unit is equally long on both axes.
        ticks: names of the places 0, 1, ... of a horizontal axis that compares things.
        radius: of the planet at the origin of an orbit, in the unit of the axes; 0 is none.
        limits: of the vertical axis; None shows everything.
    """

    series: tuple[Series, ...]
    x: str
    y: str
    z: str = ""
    log: bool = False
    equal: bool = False
    ticks: tuple[str, ...] = ()
    radius: float = 0.0
    limits: tuple[float, float] | None = None


class Drawing(NamedTuple):
    """A figure of a report.

    Attributes:
        name: of its files and its anchor, such as `molniya_orbits`.
        title: one line.
        caption: what it shows and of which runs, with the figure of the paper that it answers to.
        panels: one below another.
        kind: `lines`; `orbit`, one panel in three dimensions; or `bars`, dots with their spread.
    """

    name: str
    title: str
    caption: str
    panels: tuple[Panel, ...]
    kind: Kind = "lines"

"""Figures as data, independent of the interactive and static renderers."""

from __future__ import annotations

from typing import Literal, NamedTuple

from torch import Tensor

Role = Literal["model", "seed", "truth", "floor", "filter", "measurement", "paper", "term", "track"]
Kind = Literal["lines", "orbit", "dots"]


class Series(NamedTuple):
    """Curve, or dots of one compared item.

    Attributes:
        label: legend label; series with equal labels are toggled together.
        x, y: values, (T,); NaN interrupts a curve.
        z: third coordinate of an orbit, (T,).
        role: role of the series. A `filter` is a model with a filter, a `seed` one of several runs of a
            model, a `term` a part of a sum, a `track` a true path, solid since dashes of revolutions overlap.
        slot: index of its model in the report, or of its term; role and slot determine colour and dash, so
            that a model looks the same in every figure.
        low, high: band about a curve, (T,).
        hover: further values of the tooltip, by name with unit, each (T,).
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
        series: series, the first at the back.
        x, y, z: labels, with their units.
        log: whether the vertical axis is logarithmic.
        equal: whether both axes have equal scale.
        ticks: labels of positions 0, 1, ... on a categorical horizontal axis.
        radius: radius of the planet at the origin of an orbit, in the unit of the axes; 0: no planet.
        limits: limits of the vertical axis; None for all data.
        note: text beside the label of the vertical axis.
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
    note: str = ""


class Drawing(NamedTuple):
    """Figure of a report.

    Attributes:
        name: name of its files and its anchor, such as `molniya_orbits`.
        title: one-line title.
        caption: content and runs, with the corresponding figure of the paper.
        panels: panels from top to bottom.
        kind: `lines`; `orbit`, one panel in three dimensions; or `dots` over a categorical axis.
        spread: meaning of bands or of the dots of seeds, below the title; "" without them.
    """

    name: str
    title: str
    caption: str
    panels: tuple[Panel, ...]
    kind: Kind = "lines"
    spread: str = ""

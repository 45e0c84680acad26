"""Numbers of plugins: means with 95 % bands are tested; all other numbers are listed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, NamedTuple

from ahnn.evaluation.results import plain
from ahnn_plugins.report.grid import Cell, Grid, Head, Line, shown

BAND = "band_95"
LONGEST = 12
"""Maximum number of list entries shown."""


class JudgedNumber(NamedTuple):
    """Mean with the band of a consistent estimator."""

    name: str
    mean: float
    low: float
    high: float


def judged(numbers: Any, name: str = "") -> Iterator[JudgedNumber]:
    """Yield every mean that has a band in nested numbers, named by its path."""
    if not isinstance(numbers, dict):
        return
    band, mean = numbers.get(BAND), numbers.get("mean")
    if isinstance(mean, int | float) and isinstance(band, list) and len(band) == 2:
        if all(isinstance(limit, int | float) for limit in band):
            yield JudgedNumber(name, float(mean), float(band[0]), float(band[1]))
        return
    for key, value in numbers.items():
        yield from judged(value, f"{name} / {key}" if name else str(key))


def consistency_table(system: str, numbers: dict[str, Any]) -> Grid | None:
    """Build the table of the estimators' consistency; None without means that have a band."""
    lines = []
    for each in judged(numbers):
        inside = each.low <= each.mean <= each.high
        says = "consistent" if inside else "overconfident" if each.mean > each.high else "too cautious"
        band = f"{shown(each.low)} to {shown(each.high)}"
        lines.append(
            Line(each.name.replace("_", " "), (Cell(shown(each.mean)), Cell(band), Cell(says, "words")))
        )
    if not lines:
        return None
    caption = (
        "Normalised squared errors (NEES) and innovations (NIS): mean over trajectories and times, with the "
        "95 % band of a consistent filter. Above the band the filter is overconfident."
    )
    heads = ((Head("Where"), Head("mean"), Head("95 % band"), Head("verdict")),)
    return Grid(f"consistency_{system}", "Consistency.", caption, heads, tuple(lines))


def as_text(numbers: Any) -> str:
    """Return nested numbers as readable JSON, with long lists shortened."""
    return json.dumps(plain(_cut(numbers)), indent=1, ensure_ascii=False)


def _cut(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _cut(item) for key, item in value.items()}
    if isinstance(value, list):
        more = [f"... {len(value)} in all"] if len(value) > LONGEST else []
        return [*map(_cut, value[:LONGEST]), *more]
    return value

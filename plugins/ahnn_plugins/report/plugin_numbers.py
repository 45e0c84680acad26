"""Numbers of plugins: means with 95 % bands are tested; all other numbers are listed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from ahnn_plugins.report.grid import NONE, Cell, Grid, Head, Line, as_printed, shown

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


def listed(numbers: Any, name: str = "") -> Iterator[tuple[str, str]]:
    """Yield path and text of every value in nested numbers; missing values are omitted, long lists cut."""
    if isinstance(numbers, dict):
        for key, value in numbers.items():
            words = str(key) if "." in str(key) else str(key).replace("_", " ")
            yield from listed(value, f"{name} / {words}" if name else words)
    elif isinstance(numbers, list) and any(isinstance(item, dict) for item in numbers):
        for count, item in enumerate(numbers[:LONGEST], 1):
            yield from listed(item, f"{name} {count}")
        if len(numbers) > LONGEST:
            yield name, f"... {len(numbers)} in all"
    elif text := _text(numbers):
        yield name, text


def _text(value: Any) -> str:
    """Return a value, or a list of values or rows, as text; empty if missing."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return as_printed(value)
    if isinstance(value, list):
        rows = any(isinstance(item, list) for item in value)
        more = [f"... {len(value)} in all"] if len(value) > LONGEST else []
        return ("; " if rows else ", ").join([*(_text(item) or NONE for item in value[:LONGEST]), *more])
    return str(value)

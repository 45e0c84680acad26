"""Time spans for readers, in a unit that keeps them short."""

from __future__ import annotations

from ahnn.data.files.units import TIME, unit

LONGER = (("d", 86400.0), ("h", 3600.0), ("min", 60.0))


def duration(seconds: float) -> str:
    """Format a duration, such as 13.2 h."""
    name, size = next(((name, size) for name, size in LONGER if seconds >= 2 * size), ("s", 1.0))
    return f"{seconds / size:.1f} {name}"


def spelled_span(span: float, base: str) -> str:
    """Format a span in a unit: as a duration, or as a number if the unit is none of time."""
    try:
        found = unit(base)
    except ValueError:
        return f"{span:.3g} {base}"
    return duration(span * found.size) if found.dimension == TIME else f"{span:.3g}"

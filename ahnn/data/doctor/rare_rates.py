"""Test for velocities or momenta that are missing where positions are measured."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ahnn.data.doctor.finding import Finding
from ahnn.data.files.content import Content

RARE = 1 / 3
"""Fraction of the rows with positions beyond which a column of rates counts as rarely measured."""


def rarely_measured(content: Content) -> list[int]:
    """Return the columns of rates that are missing in more than a third of the rows with positions."""
    values, n = np.concatenate([track.values for track in content.tracks]), len(content.positions)
    known = values[np.isfinite(values[:, :n]).all(1), n:]
    return [n + int(c) for c in np.flatnonzero(np.isnan(known).sum(0) > RARE * len(known))]


def missing_rates(content: Content, rare: Sequence[int]) -> Iterator[Finding]:
    """Yield a finding for each column of rates that is missing in many rows with positions."""
    values, n = np.concatenate([track.values for track in content.tracks]), len(content.positions)
    known = values[np.isfinite(values[:, :n]).all(1)]
    for c in rare:
        name, count = content.rates[c - n], int(np.isnan(known[:, c]).sum())
        if count == len(known):
            remedy = f"Leave out column {name}"
            yield Finding("fault", content.tracks[0].file, content.head, name, "an empty column", remedy)
            continue
        what = f"missing in {count:,} of {len(known):,} rows with positions"
        remedy = (
            "With data.noise, the positions of these rows are used; training on exact states ignores the "
            f"rows: leave out column {name} to use them"
        )
        yield Finding("warning", content.tracks[0].file, content.head, name, what, remedy)

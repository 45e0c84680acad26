"""Tests of samples: missing values, gaps, constant columns, outliers, wide angles, noise."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence

import numpy as np

from ahnn.data.doctor.finding import Finding, Level
from ahnn.data.doctor.rare_rates import missing_rates, rarely_measured
from ahnn.data.doctor.slopes import interpolated
from ahnn.data.doctor.spans import spelled_span
from ahnn.data.files.content import Content
from ahnn.data.files.samples import Track, cut_for_splits, filled, stacked, steps_in_medians
from ahnn.data.files.table import Fault
from ahnn.data.files.units import ANGLE, unit
from ahnn.data.noise_floor import ORDERS, SHARE, differences_level, looked_at, noise_floor

BENT, FAR = 30.0, 8.0
"""An outlier is further from the polynomial through its neighbours than the sum of these multiples of the
polynomial's uncertainty and of the typical deviation.
"""
EVEN, SPREAD, LEAST = 0.1, 4.0, 1e-6
"""Outlier criteria: maximum deviation of the neighbours that the sample does not explain, in parts of its own
plus typical ones, and minimum deviation relative to the largest value.
"""
SHARE_OF_POSITIONS = 1e-7
"""Smallest noise reported for positions alone, relative to increments: they are learned as measurements."""
JUMP = 30.0
"""Step into a run of values on another scale, in typical steps."""
WIDE, NEAR = 100.0, 10.0
"""Deviations from the median of a file, in robust standard deviations: some value in a run on another scale
exceeds the first, and all of them exceed the second.
"""
EXAMPLES = 64
"""Number of trajectories of a file whose noise is estimated."""


def sample_findings(content: Content, gap: float) -> Iterator[Finding]:
    """Yield findings on missing values, gaps, outliers, constant columns, wide angles, and noise.

    Args:
        content: content of a file.
        gap: multiple of the median step that counts as a gap, for samples not on a grid.
    """
    names = (*content.positions, *content.rates)
    rare = rarely_measured(content)
    yield from missing_rates(content, rare)
    for track in content.tracks:
        yield from missing(track, names, rare)
        yield from gaps(track, content.time, gap, content.units.time)
        yield from outliers(track, content)
    yield from runs_of_outliers(content, names)
    yield from constant(content, names)
    if unit(content.units.position).dimension == ANGLE:
        yield from too_wide(content)
    yield from noise(content, names, gap)


def missing(track: Track, names: tuple[str, ...], rare: Sequence[int] = ()) -> Iterator[Finding]:
    """Yield a finding for each missing value, except in columns named as a whole."""
    for k, c in zip(*np.nonzero(np.isnan(track.values)), strict=True):
        if c in rare:
            continue
        remedy = "Nothing to do: the sample counts as missing"
        yield Finding("warning", track.file, int(track.rows[k]), names[c], "a missing number", remedy)


def gaps(track: Track, column: str, gap: float, base: str = "1") -> Iterator[Finding]:
    """Yield a finding for each sample after a gap.

    Args:
        track: samples of a trajectory.
        column: name of the time column.
        gap: multiple of the median step that counts as a gap, for samples not on a grid.
        base: unit of time.
    """
    try:
        whole = filled(track, gap)
    except Fault as fault:
        yield Finding.of(fault)
        return
    there = np.flatnonzero(whole.rows)
    if len(there) == len(whole.rows):
        return
    ratio, on_grid = steps_in_medians(track.times)
    for k in np.flatnonzero(np.diff(there) > 1):
        absent = int(there[k + 1] - there[k] - 1)
        span, row = float(np.diff(whole.times[there[[k, k + 1]]])[0]), int(whole.rows[there[k + 1]])
        samples = f"{absent} sample{' is' if absent == 1 else 's are'} missing before this one"
        size = samples if on_grid else f"{ratio[k]:.0f} times the median step before this sample"
        what = f"a gap of {spelled_span(span, base)}: {size}"
        remedy = "Nothing to do: no window crosses it"
        yield Finding("warning", track.file, row, column, what, remedy, span)


def constant(content: Content, names: tuple[str, ...]) -> Iterator[Finding]:
    """Yield findings on columns constant in the entire file, which provide no information."""
    values = np.concatenate([track.values for track in content.tracks])
    if len(values) < 3:
        return
    for c, name in enumerate(names):
        known = values[np.isfinite(values[:, c]), c]
        if len(known) and known.min() == known.max():
            what, remedy = f"always {known[0]:g}", "Leave it out: it does not move"
            level: Level = "fault" if c < len(content.positions) else "warning"
            yield Finding(level, content.tracks[0].file, content.head, name, what, remedy)


def too_few(contents: Sequence[Content]) -> Iterator[Finding]:
    """Yield a finding if all files together contain too few data for training or test."""
    tracks = [track for content in contents for track in content.tracks]
    if not tracks:
        return
    file, head, column = tracks[0].file, contents[0].head, contents[0].time
    if max(len(track.times) for track in tracks) < 2:
        what = "only one sample in each trajectory, so there is no step to learn from"
        yield Finding("fault", file, head, column, what, "Give more samples per trajectory")
    elif len(tracks) == 1:
        what = "only one trajectory for training, validation and test"
        option = cut_for_splits(len(tracks[0].times))
        remedy = f"Cut it into several (for example {option}), or give more" if option else "Give more"
        yield Finding("warning", file, head, "", what, remedy)


def outliers(track: Track, content: Content) -> Iterator[Finding]:
    """Yield isolated samples far from the polynomials through their neighbours, if these agree.

    Args:
        track: samples of a trajectory.
        content: content of its file, with names and units.
    """
    names = (*content.positions, *content.rates)
    count = len(track.times)
    if count < 11:
        return
    at = np.arange(4, count - 4)
    (near, pull), *fewer = (interpolated(track.times, track.values, at, k) for k in (4, 3, 2))
    left, gain = track.values[at] - near, np.sqrt(1 + (pull**2).sum(axis=1, keepdims=True))
    off = np.abs(left)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # columns without a number
        noise, size = gain * np.nanmedian(off / gain, axis=0), np.nanmax(np.abs(track.values), axis=0)
    (near_of_6, _), (near_of_4, _) = fewer
    doubt = np.abs(near - near_of_6) + 0.1 * np.abs(near_of_6 - near_of_4)
    far = (off > BENT * doubt + FAR * noise) & (off > LEAST * size)
    # an outlier displaces the curves at its two neighbours by its weight in them; a jump displaces them more
    for k, by in ((4, -1), (3, 1)):
        unexplained = np.abs(left + pull[:, [k]] * np.roll(left, by, axis=0))
        far &= np.roll(unexplained - SPREAD * noise, -by, axis=0) < EVEN * off
    for k, c in zip(*np.nonzero(far), strict=True):
        size = float(off[k, c])
        what = f"an outlier: {of_column(content, c, size)} from the curve through its neighbours"
        remedy = "Correct it, leave the cell empty, or train with loss.robust=student"
        yield Finding("warning", track.file, int(track.rows[at[k]]), names[c], what, remedy, size)


def runs_of_outliers(content: Content, names: tuple[str, ...]) -> Iterator[Finding]:
    """Yield successive values on a different scale from the rest of the file, entered and left by jumps."""
    values = np.concatenate([track.values for track in content.tracks])
    for c, name in enumerate(names):
        known = values[np.isfinite(values[:, c]), c]
        middle = np.median(known) if len(known) else 0.0
        spread = 1.4826 * np.median(np.abs(known - middle)) if len(known) else 0.0
        for track in content.tracks if spread > 0 else ():
            there = np.flatnonzero(np.isfinite(track.values[:, c]))
            off = np.abs(track.values[there, c] - middle) / spread
            steps = np.abs(np.diff(track.values[there, c])) / spread
            for first, last in runs(off > NEAR):
                edges = [k for k in (first - 1, last) if 0 <= k < len(steps)]  # steps at both ends of the run
                wide = last > first and off[first : last + 1].max() > WIDE
                if wide and edges and steps[edges].min() > JUMP * np.median(steps):
                    rows = track.rows[there[[first, last]]]
                    what = (
                        f"{last - first + 1} successive values, rows {rows[0]} to {rows[1]}, are up to "
                        f"{off[first : last + 1].max():.2g} times the spread of the file away from all "
                        "other values"
                    )
                    remedy = "Correct them (is their unit different?), or leave the cells empty"
                    yield Finding("warning", track.file, int(rows[0]), name, what, remedy)


def runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Return first and last index of each run of true values of (T,), across holes of up to two samples."""
    at = np.flatnonzero(mask)
    parts = np.split(at, np.flatnonzero(np.diff(at) > 3) + 1) if len(at) else []
    return [(int(part[0]), int(part[-1])) for part in parts]


def too_wide(content: Content) -> Iterator[Finding]:
    """Yield findings on angles that oscillate over more than one turn, which are probably degrees."""
    for c, name in enumerate(content.positions):
        for track in content.tracks:
            angle = track.values[np.isfinite(track.values[:, c]), c]
            if not len(angle):
                continue
            fall = (np.maximum.accumulate(angle) - angle).max()
            rise = (angle - np.minimum.accumulate(angle)).max()
            if min(fall, rise) > 2 * np.pi:
                what = f"oscillates over {np.ptp(angle):.3g} rad, more than a turn"
                yield Finding(
                    "warning",
                    track.file,
                    content.head,
                    name,
                    what,
                    "If these are degrees, state the unit: [deg]",
                )
                break


def of_column(content: Content, c: int, value: float) -> str:
    """Return a value of a column in the unit of the file, followed by the value in the unit of the space.

    Pure numbers and momenta have no unit.

    Args:
        content: content of a file.
        c: index of the column among positions and rates.
        value: value in the unit of the space.
    """
    n = len(content.positions)
    here = content.units.position if c < n else content.units.velocity
    if here == "1" or (content.momenta and c >= n):
        return f"{value:.2g}"
    name = (*content.positions, *content.rates)[c]
    own = next((column.unit for column in content.columns if column.name == name), "") or here
    shown = f"{value:.2g} {here}"
    return shown if own == here else f"{value * unit(here).size / unit(own).size:.2g} {own}, that is {shown}"


def noise(content: Content, names: tuple[str, ...], gap: float) -> Iterator[Finding]:
    """Yield the noise level of each noisy column."""
    every = max(1, len(content.tracks) // EXAMPLES)
    try:
        some = stacked([filled(track, gap) for track in content.tracks[::every]])
    except Fault:
        return
    samples, times = looked_at(some.states, some.times)
    if samples.shape[1] <= ORDERS[-1]:
        return
    typical = samples.diff(dim=1).abs().flatten(0, 1).nanmedian(0).values
    file, plateau = content.tracks[0].file, differences_level(samples, times)
    found = noise_floor(samples, times)
    rare = (plateau > SHARE * typical) & found.isnan()
    alone = len(names) == len(content.positions)
    least = SHARE_OF_POSITIONS if alone else SHARE
    for c, (name, level, step) in enumerate(zip(names, found.tolist(), typical.tolist(), strict=True)):
        if level > least * step > 0:
            remedy = f"Train with data.noise={f'{level:.2g}' if alone else 'estimate'}"
            what = f"noise of about {of_column(content, c, level)}"
            yield Finding("note", file, content.head, name, what, remedy)
    if bool(rare.any()):
        remedy = "Give more samples per period: noise and units were not checked"
        yield Finding(
            "note", file, content.head, content.time, "samples too sparse to follow the motion", remedy
        )

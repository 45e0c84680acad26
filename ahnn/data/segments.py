"""Segments of measured trajectories by index arithmetic, analogous to windows of states."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.measurements import Instrument, Observations, Segment
from ahnn.measurements.smoothing import DEGREE, FIRST, located_at, no_start

SHORTEST = 4
"""Minimum number of intervals of segments that are cut from others."""


class Segments:
    """All segments of K intervals that begin where an initial state can be estimated.

    Segments may contain gaps. Samples beyond the end of a trajectory are unmeasured.

    Args:
        measured: values (B, T, M) and times (B, T); NaN where missing.
        intervals: number K of intervals. None, or more than any trajectory has after a suitable start: one
            segment per trajectory, from its first suitable start to its end.
        instrument: measuring instrument.

    Attributes:
        intervals: number of intervals of each segment.
        covering: number of segments that together contain as many measurements as the data; more would only
            overlap.

    Raises:
        UserError: no initial state can be estimated.
    """

    def __init__(self, measured: Observations, intervals: int | None, instrument: Instrument) -> None:
        self.values, times = measured
        rows, samples = times.shape
        self.instrument = instrument
        there = located_at(instrument, self.values, times).isfinite().all(-1)
        good = there & (ahead(there, FIRST) > DEGREE)
        if not bool(good.any()):
            no_start(times)
        last = (times.isfinite() * torch.arange(samples)).amax(1, keepdim=True)
        fitting = good & (torch.arange(samples) + (intervals or samples) <= last)
        if intervals is None or not bool(fitting.any()):
            intervals, fitting = samples - 1, good & (good.cumsum(1) == 1)
        self.intervals, self.begins = intervals, fitting.nonzero()
        self.covering = max(1, round(float(there.sum()) / self.intervals))
        # Times beyond the end of a trajectory continue with its own step, so that all times increase.
        step = (times.gather(1, last) - times[:, :1]) / last.clamp(min=1)
        beyond = torch.arange(samples + self.intervals) - last
        filled = torch.cat((times, times.new_full((rows, self.intervals), torch.nan)), dim=1)
        self.times = torch.where(beyond > 0, times.gather(1, last) + beyond * step, filled)
        self.offsets = torch.arange(self.intervals + 1)

    def __len__(self) -> int:
        """Return the number of segments."""
        return len(self.begins)

    def gather(self, index: Tensor) -> Segment:
        """Return the segments of `index`, shape (B,), as one batch."""
        row, column = self.begins[index].unsqueeze(1).unbind(-1)
        columns = column + self.offsets
        inside = columns < self.values.shape[1]
        values = self.values[row, columns.clamp(max=self.values.shape[1] - 1)]
        values = values.masked_fill(~inside.unsqueeze(-1), torch.nan)
        return Segment(values, self.times[row, columns], self.instrument)


def whole(measured: Observations, instrument: Instrument) -> Segment:
    """Return trajectories from their first suitable start on; raises the same errors as `Segments`."""
    segments = Segments(measured, None, instrument)
    return segments.gather(torch.arange(len(segments)))


def shortened(whole: Segment, divisor: int) -> Segment:
    """Return segments of a fraction 1 / divisor of the length, which together contain about all measurements.

    They have at least SHORTEST intervals.
    """
    intervals = max(whole.times.shape[1] // divisor, SHORTEST)
    segments = Segments(Observations(whole.values, whole.times), intervals, whole.instrument)
    return segments.gather(torch.arange(0, len(segments), max(len(segments) // segments.covering, 1)))


def ahead(there: Tensor, count: int) -> Tensor:
    """Return the number of samples present among the `count` from each sample on, (B, T) from (B, T) bool."""
    padded = torch.nn.functional.pad(there.long(), (0, count))
    sums = torch.nn.functional.pad(padded.cumsum(1), (1, 0))
    return sums[:, count : count + there.shape[1]] - sums[:, : there.shape[1]]

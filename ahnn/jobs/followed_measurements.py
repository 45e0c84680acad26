"""Measurements filtered after an orbit determination, and their innovations."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ahnn.assimilation import Estimate, Reading
from ahnn.estimation import Belief
from ahnn.tracking.residual_table import ResidualRow, correlation_of, table_lines, trend_of
from ahnn.tracking.satellite_flow import SIZE
from ahnn.tracking.tracking_data import KINDS, TrackingData


@dataclass(eq=False)
class FollowedMeasurements:
    """Measurements of a satellite as lines of a stream, and the innovations of accepted ones.

    Attributes:
        data: all measurements, including the fitted ones.
        rows: mask of the filtered measurements, (N,) bool.
        names: names of all estimated components.
        beside: function of the final mean and time that returns further lines to report.
        innovations: times, innovations and their standard deviations, by station and kind.
    """

    data: TrackingData
    rows: NDArray[np.bool_]
    names: tuple[str, ...]
    beside: Callable[[NDArray[np.float64], float], list[str]]
    innovations: dict[tuple[int, int], list[tuple[float, float, float]]] = field(default_factory=dict)

    @property
    def content(self) -> bytes:
        """The filtered measurements as a table; times are in seconds after the epoch of the data."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        kinds = [k for k, column in enumerate(self.data.values.T) if np.isfinite(column).any()]
        writer.writerow(("time", "sensor", *(KINDS[k] for k in kinds)))
        for n in np.flatnonzero(self.rows):
            cells = ["" if np.isnan(x) else repr(float(x)) for x in self.data.values[n, kinds]]
            writer.writerow(
                (repr(float(self.data.times[n])), self.data.stations[self.data.station[n]], *cells)
            )
        return text.getvalue().encode()

    def kinds(self, station: int) -> list[int]:
        """Return the indices of the `KINDS` that a station measures."""
        seen = np.isfinite(self.data.values[self.data.station == station]).any(0)
        return [int(k) for k in np.flatnonzero(seen)]

    def __call__(self, number: int, reading: Reading, estimate: Estimate, counts: Counter[str]) -> None:
        """Record the innovation of an accepted reading; see `ahnn.assimilation.session.Watcher`."""
        if estimate.innovation is None or estimate.outcome != "taken":
            return
        station = self.data.stations.index(reading.sensor)
        innovation = estimate.innovation.residual[0].tolist(), estimate.innovation.deviation[0].tolist()
        for kind, e, sd in zip(self.kinds(station), *innovation, strict=True):
            if e == e:
                self.innovations.setdefault((station, kind), []).append((reading.time, e, sd))

    def lines(self, moments: Belief, time: float) -> list[str]:
        """Return a table of innovations and biases, and the final parameters of known forces."""
        mean, deviations = moments.mean[0].tolist(), moments.chol[0].norm(dim=-1).tolist()
        known = {name: (mean[k], deviations[k]) for k, name in enumerate(self.names)}
        rows = []
        for (station, kind), series in sorted(self.innovations.items()):
            t, e, sd = np.array(series).T
            name = self.data.stations[station]
            bias = known.get(f"bias {name} {KINDS[kind]}", (np.nan, np.nan))
            numbers = len(e), float(e.mean()), float(e.std()), trend_of(t, e), correlation_of(e)
            rows.append(ResidualRow(name, KINDS[kind], *numbers, float(np.sqrt(np.mean(sd**2))), bias))
        others = [name for name in self.names[SIZE:] if not name.startswith(("bias ", "learned "))]
        return [
            "innovations, measured minus predicted, compared with the uncertainty of both:",
            *table_lines(rows),
            *(f"  {name} {known[name][0]:.6g} ± {known[name][1]:.2g}" for name in others),
            *self.beside(moments.mean[0].numpy(), time),
        ]

"""Output of many objects' estimates as text rows, with the column names used for one object."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from torch import Tensor

from ahnn.assimilation.output_rows import Format, Rows
from ahnn.assimilation.reading_table import Array, CatalogueEstimates, ReadingTable
from ahnn.assimilation.stream_clock import StreamClock
from ahnn.assimilation.stream_sensor import StreamSensor
from ahnn.data.estimate_table import DATED, FIRST, OBJECT
from ahnn.data.files.parquet import packed_table
from ahnn.data.files.sidecar import Sidecar


class CatalogueRows(Rows):
    """Output rows of a catalogue; arguments as in `Rows`."""

    def __init__(
        self,
        components: tuple[str, ...],
        sensors: Mapping[str, StreamSensor],
        kind: Format,
        said: Sidecar | None = None,
        *,
        scales: Tensor | None = None,
        clock: StreamClock | None = None,
    ) -> None:
        super().__init__(components, sensors, kind, said, scales=scales, clock=clock)
        self.names.insert(1, OBJECT)
        self.sensors = [*sensors, ""]  # index -1: no sensor

    def columns(self, lines: list[int], readings: ReadingTable, found: CatalogueEstimates) -> dict[str, Any]:
        """Return the output of processed readings by column name.

        Args:
            lines: (K,) line numbers.
            readings: K readings.
            found: estimates after the readings.
        """
        chosen, outcomes = np.flatnonzero(found.counted), found.outcomes
        first = {
            FIRST[0]: np.array(lines, dtype=np.int64)[chosen],
            OBJECT: [readings.objects[k] for k in chosen.tolist()],
            FIRST[1]: found.times[chosen],
            **self._epochs(found.times[chosen]),
            FIRST[2]: [self.sensors[k] for k in readings.sensors[chosen].tolist()],
            FIRST[3]: [outcomes[k] for k in chosen.tolist()],
            FIRST[4]: found.replayed[chosen],
            FIRST[5]: found.nis.numpy()[chosen],
            FIRST[6]: found.measured.numpy()[chosen],
        }
        numbers = self._numbers(found, chosen)
        return first | dict(zip(self.names[len(first) :], numbers.T, strict=True))

    def batch(self, lines: list[int], readings: ReadingTable, found: CatalogueEstimates) -> str | bytes:
        """Return the output of processed readings as a batch; arguments as in `columns`."""
        if self.kind == "parquet":
            return packed_table(self.columns(lines, readings, found))
        return self.text(self.columns(lines, readings, found))

    def _epochs(self, times: Array) -> dict[str, list[str]]:
        """Return the column of epochs; {} if time zero has no epoch."""
        if self.clock is None:
            return {}
        known = {time: self.clock.epoch(time) for time in set(times.tolist())}
        return {DATED[2]: [known[time] for time in times.tolist()]}

    def _numbers(self, found: CatalogueEstimates, chosen: Any) -> Array:
        """Return means, lower triangles of covariances, innovations and their standard deviations, (K, C)."""
        rows, columns = zip(*self.lower, strict=True)
        covariances = found.covariances / self.scales.outer(self.scales)
        triangles = covariances.numpy()[chosen][:, list(rows), list(columns)]
        parts = found.means / self.scales, found.residuals, found.deviations
        means, residuals, deviations = (part.numpy()[chosen] for part in parts)
        return np.concatenate((means, triangles, residuals, deviations), axis=1)

"""Output of many objects' estimates as text rows, with the column names used for one object."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from torch import Tensor

from ahnn.assimilation.output_rows import Column, Format, Rows
from ahnn.assimilation.reading_table import CatalogueEstimates, ReadingTable
from ahnn.assimilation.stream_clock import StreamClock
from ahnn.assimilation.stream_sensor import StreamSensor
from ahnn.data.estimate_table import OBJECT
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
        first: list[Column] = [
            np.array(lines, dtype=np.int64)[chosen],
            [readings.objects[k] for k in chosen.tolist()],
            found.times[chosen],
            *self.epochs(found.times[chosen]),
            [self.sensors[k] for k in readings.sensors[chosen].tolist()],
            [outcomes[k] for k in chosen.tolist()],
            found.replayed[chosen],
            found.nis.numpy()[chosen],
            found.measured.numpy()[chosen],
        ]
        parts = found.means, found.covariances, found.residuals, found.deviations
        numbers = self.numbers(*(part.numpy()[chosen] for part in parts))
        return dict(zip(self.names, [*first, *numbers.T], strict=True))

    def batch(self, lines: list[int], readings: ReadingTable, found: CatalogueEstimates) -> str | bytes:
        """Return the output of processed readings as a batch; arguments as in `columns`."""
        if self.kind == "parquet":
            return packed_table(self.columns(lines, readings, found))
        return self.text(self.columns(lines, readings, found))

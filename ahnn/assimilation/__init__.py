"""Online filtering: measurements are read line by line, estimates written, and the state saved."""

from __future__ import annotations

from ahnn.assimilation.catalogue import Catalogue
from ahnn.assimilation.instrument_reading import Reading
from ahnn.assimilation.online import Assimilation
from ahnn.assimilation.reading_table import CatalogueEstimates, ReadingTable
from ahnn.assimilation.stream_estimate import Estimate
from ahnn.assimilation.stream_sensor import StreamSensor
from ahnn.estimation.process_model import Process

__all__ = [
    "Assimilation",
    "Catalogue",
    "CatalogueEstimates",
    "Estimate",
    "Process",
    "Reading",
    "ReadingTable",
    "StreamSensor",
]

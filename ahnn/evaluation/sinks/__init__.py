"""Output sinks: each is called with results and findings, and writes one kind of output."""

from __future__ import annotations

from ahnn.evaluation.sinks.base import Sink, TensorBoardLike
from ahnn.evaluation.sinks.figure_files import FigureSink
from ahnn.evaluation.sinks.metrics_file import MetricsSink
from ahnn.evaluation.sinks.predictions import PredictionSink
from ahnn.evaluation.sinks.tensorboard import TensorBoardSink
from ahnn.evaluation.sinks.terminal_table import TableSink

__all__ = [
    "FigureSink",
    "MetricsSink",
    "PredictionSink",
    "Sink",
    "TableSink",
    "TensorBoardLike",
    "TensorBoardSink",
]

"""Where results go: each sink is a value that is called with results and findings, and writes one thing."""

from __future__ import annotations

from ahnn.evaluation.sinks.base import Sink, TensorBoardLike
from ahnn.evaluation.sinks.figures import FigureSink
from ahnn.evaluation.sinks.metrics import MetricsSink
from ahnn.evaluation.sinks.predictions import PredictionSink
from ahnn.evaluation.sinks.table import TableSink
from ahnn.evaluation.sinks.tensorboard import TensorBoardSink

__all__ = [
    "FigureSink",
    "MetricsSink",
    "PredictionSink",
    "Sink",
    "TableSink",
    "TensorBoardLike",
    "TensorBoardSink",
]

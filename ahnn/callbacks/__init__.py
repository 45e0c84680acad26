"""Lightning callbacks of the library: the progress bar, telemetry, and rollouts on validation data."""

from __future__ import annotations

from ahnn.callbacks.progress import TrainingProgress
from ahnn.callbacks.rollout import ValidationRollout
from ahnn.callbacks.telemetry import Telemetry

__all__ = ["Telemetry", "TrainingProgress", "ValidationRollout"]

"""Lightning callbacks of the library: progress bar, telemetry, resume points, validation rollouts."""

from __future__ import annotations

from ahnn.callbacks.progress import TrainingProgress
from ahnn.callbacks.resume_point import ResumePoint
from ahnn.callbacks.rollout import ValidationRollout
from ahnn.callbacks.telemetry import Telemetry

__all__ = ["ResumePoint", "Telemetry", "TrainingProgress", "ValidationRollout"]

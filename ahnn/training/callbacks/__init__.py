"""Lightning callbacks: progress bar, telemetry, checkpoints for resumption, validation rollouts."""

from __future__ import annotations

from ahnn.training.callbacks.checkpointing import BestPoint, ResumePoint, require_monitored
from ahnn.training.callbacks.epoch_mean import EpochMean
from ahnn.training.callbacks.member_points import MemberPoints
from ahnn.training.callbacks.progress import TrainingProgress
from ahnn.training.callbacks.rollout import ValidationRollout
from ahnn.training.callbacks.telemetry import Telemetry

__all__ = [
    "BestPoint",
    "EpochMean",
    "MemberPoints",
    "ResumePoint",
    "Telemetry",
    "TrainingProgress",
    "ValidationRollout",
    "require_monitored",
]

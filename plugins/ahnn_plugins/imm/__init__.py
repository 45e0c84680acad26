"""Interacting multiple models: one Gaussian filter per mode of the motion, mixed by mode transitions."""

from __future__ import annotations

from ahnn_plugins.imm.interacting_models import InteractingModels
from ahnn_plugins.imm.mixture import MixtureState
from ahnn_plugins.imm.motion_mode import MotionMode

__all__ = ["InteractingModels", "MixtureState", "MotionMode"]

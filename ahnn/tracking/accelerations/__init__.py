"""What accelerates a satellite: known terms and learned ones, with their derivatives."""

from __future__ import annotations

from ahnn.tracking.accelerations.contract import Acceleration, AccelerationTerm

__all__ = ["Acceleration", "AccelerationTerm"]

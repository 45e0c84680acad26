"""Known and learned accelerations of a satellite, with derivatives."""

from __future__ import annotations

from ahnn.tracking.accelerations.contract import Acceleration, AccelerationTerm

__all__ = ["Acceleration", "AccelerationTerm"]

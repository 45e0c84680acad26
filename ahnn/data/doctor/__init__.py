"""Data doctor: finds all defects of data in one pass before training."""

from __future__ import annotations

from ahnn.data.doctor.examine import Examined, diagnosis, examine
from ahnn.data.doctor.finding import Finding, Level

__all__ = ["Examined", "Finding", "Level", "diagnosis", "examine"]

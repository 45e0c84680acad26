"""What is wrong with data before anything is learned from them: all of it, in one pass."""

from __future__ import annotations

from ahnn.data.doctor.examine import Examined, diagnosis, examine
from ahnn.data.doctor.finding import Finding, Level

__all__ = ["Examined", "Finding", "Level", "diagnosis", "examine"]

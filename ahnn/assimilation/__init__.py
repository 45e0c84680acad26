"""The filter online: measurements line by line as they come, estimates out, a state that survives a kill."""

from __future__ import annotations

from ahnn.assimilation.online import Assimilation, Estimate
from ahnn.assimilation.reading import Reading
from ahnn.assimilation.sensor import Sensor
from ahnn.estimation.process import Process

__all__ = ["Assimilation", "Estimate", "Process", "Reading", "Sensor"]

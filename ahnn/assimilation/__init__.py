"""The filter online: measurements line by line as they come, estimates out, a state that survives a kill."""

from __future__ import annotations

from ahnn.assimilation.online import Assimilation, Estimate
from ahnn.assimilation.process import Process, Sensor
from ahnn.assimilation.reading import Reading

__all__ = ["Assimilation", "Estimate", "Process", "Reading", "Sensor"]

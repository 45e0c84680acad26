"""Trajectories and measurements from files: a parser for each format, and the data source."""

from __future__ import annotations

from ahnn.data.files.ephemeris import Covariance, Ephemeris
from ahnn.data.files.epochs import instant
from ahnn.data.files.messages import read_oem, read_opm, write_oem
from ahnn.data.files.source import Files

__all__ = ["Covariance", "Ephemeris", "Files", "instant", "read_oem", "read_opm", "write_oem"]

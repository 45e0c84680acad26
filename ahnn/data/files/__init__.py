"""Trajectories and measurements from files: a pure parser for each format, and the source on top of them."""

from __future__ import annotations

from ahnn.data.files.source import Files

__all__ = ["Files"]

"""Gravity fields as spherical harmonics: coefficients, files, potential and attraction."""

from __future__ import annotations

from ahnn.systems.gravity.eigen6s import eigen6s
from ahnn.systems.gravity.field import GravityField, Tide
from ahnn.systems.gravity.gfc import read_gfc
from ahnn.systems.gravity.ggm05c import ggm05c

__all__ = ["GravityField", "Tide", "eigen6s", "ggm05c", "read_gfc"]

"""Learning Hamiltonian dynamics from data, and assimilating measurements with what was learned."""

from __future__ import annotations

__version__ = "0.1.0"

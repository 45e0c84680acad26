"""Models of dynamics: networks and learned Hamiltonians as plain modules, one LightningModule for each kind.

The HNN⁺ of the paper is `AHNN` over windows of one step, so both share the class and differ in their YAML.
"""

from __future__ import annotations

from ahnn.models.ahnn import AHNN
from ahnn.models.base import AbstractDynamics, Optimisation
from ahnn.models.mlp import MLP
from ahnn.models.node import NODE

__all__ = ["AHNN", "MLP", "NODE", "AbstractDynamics", "Optimisation"]

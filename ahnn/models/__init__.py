"""Models of dynamics, one LightningModule per kind.

The HNN⁺ of the paper is `AHNN` with windows of one step: both share a class and differ in their YAML.
"""

from __future__ import annotations

from ahnn.models.ahnn import AHNN
from ahnn.models.ensemble import EnsembleModel
from ahnn.models.lnn import LNN
from ahnn.models.mlp import MLP
from ahnn.models.module import AbstractModel, Optimisation
from ahnn.models.node import NODE
from ahnn.models.symplectic_model import SymplecticModel

__all__ = ["AHNN", "LNN", "MLP", "NODE", "AbstractModel", "EnsembleModel", "Optimisation", "SymplecticModel"]

"""Models of dynamics: one thin LightningModule for each kind.

The HNN⁺ of the paper is `AHNN` over windows of one step, so both share the class and differ in their YAML.
"""

from __future__ import annotations

from ahnn.models.ahnn import AHNN
from ahnn.models.mlp import MLP
from ahnn.models.module import AbstractModel, Optimisation
from ahnn.models.node import NODE

__all__ = ["AHNN", "MLP", "NODE", "AbstractModel", "Optimisation"]

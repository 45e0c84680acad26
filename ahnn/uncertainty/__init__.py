"""How well learned dynamics are known: the covariance of their parameters, and bands of predictions."""

from __future__ import annotations

from ahnn.uncertainty.bands import rollout_covariances, sampled_rollouts
from ahnn.uncertainty.posterior import Uncertainty, load_uncertainty, save_uncertainty

__all__ = ["Uncertainty", "load_uncertainty", "rollout_covariances", "sampled_rollouts", "save_uncertainty"]

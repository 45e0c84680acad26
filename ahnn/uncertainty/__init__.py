"""Uncertainty of learned dynamics: parameter covariance, bands, distance from training data."""

from __future__ import annotations

from ahnn.uncertainty.bands import rollout_covariances, rollout_sensitivities
from ahnn.uncertainty.constants import Constant, learned_constants
from ahnn.uncertainty.domain import BEYOND, Domain, domain_of, find_domain, growth
from ahnn.uncertainty.force import force_deviation
from ahnn.uncertainty.forecast import forecast_columns
from ahnn.uncertainty.linear_range import (
    LINEAR,
    asymmetry,
    joint_nonlinearity,
    largest_displacement,
    nonlinearity,
)
from ahnn.uncertainty.mixtures import mixture_crps, mixture_moments
from ahnn.uncertainty.posterior import Uncertainty, load_uncertainty, save_uncertainty
from ahnn.uncertainty.sampled_paths import Draws, drawn, sampled_paths, sampled_rollouts

__all__ = [
    "BEYOND",
    "LINEAR",
    "Constant",
    "Domain",
    "Draws",
    "Uncertainty",
    "asymmetry",
    "domain_of",
    "drawn",
    "find_domain",
    "force_deviation",
    "forecast_columns",
    "growth",
    "joint_nonlinearity",
    "largest_displacement",
    "learned_constants",
    "load_uncertainty",
    "mixture_crps",
    "mixture_moments",
    "nonlinearity",
    "rollout_covariances",
    "rollout_sensitivities",
    "sampled_paths",
    "sampled_rollouts",
    "save_uncertainty",
]

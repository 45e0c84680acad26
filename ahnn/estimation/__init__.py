"""Common foundations of estimators: beliefs, states, gating, evaluation scenarios and consistency tests."""

from __future__ import annotations

from ahnn.estimation.belief import Belief, Status
from ahnn.estimation.consistency import band, coverage, independent_count, nees
from ahnn.estimation.covariances import Covariance, Factor, initial_belief
from ahnn.estimation.estimator import Estimator, EstimatorState, Innovation, RecursiveEstimator
from ahnn.estimation.gate import Gate
from ahnn.estimation.saved_state import load_notes, load_state, save_state
from ahnn.estimation.scenario import Problem, Setting, perturbed_arcs, simulated
from ahnn.estimation.state import FilterState

__all__ = [
    "Belief",
    "Covariance",
    "Estimator",
    "EstimatorState",
    "Factor",
    "FilterState",
    "Gate",
    "Innovation",
    "Problem",
    "RecursiveEstimator",
    "Setting",
    "Status",
    "band",
    "coverage",
    "independent_count",
    "initial_belief",
    "load_notes",
    "load_state",
    "nees",
    "perturbed_arcs",
    "save_state",
    "simulated",
]

"""What an evaluation works on and what it finds: the interface between the library and its plugins."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import torch
from torch import Tensor

from ahnn.integrators import Integrator
from ahnn.metrics import Scores, score
from ahnn.systems import System
from ahnn.types import Flow, Trajectories

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Case:
    """A trained model on the unseen trajectories of its system; all tensors float64 on the CPU.

    Attributes:
        label: name of the model in tables.
        system: the ground truth.
        flow: the learned flow.
        learned_energy: H_theta, (..., D) -> (...), or None for a model without one.
        integrator: one-step method of the model, and of the floor beside it.
        test, validation, train: whole trajectories of the splits.
        perturbation: (B, D) initial errors of the perturbed scenario, the same for every model.
        folder: the run directory.
    """

    label: str
    system: System
    flow: Flow
    learned_energy: Any
    integrator: Integrator
    test: Trajectories
    validation: Trajectories
    train: Trajectories
    perturbation: Tensor
    folder: Path

    def starts(self) -> dict[str, Tensor]:
        """Return the initial states (B, D) of the two scenarios of the paper."""
        true = self.test.states[:, 0]
        return {"true": true, "perturbed": true + self.perturbation}

    def score(self, prediction: Tensor) -> Scores:
        """Return the scores of predicted test trajectories, shape (B, T, D)."""
        truth = self.test.states
        energies = self.system.energy(prediction), self.system.energy(truth)
        return score(prediction, truth, energies, self.system.inertia)


class Row(NamedTuple):
    """A line of the results table.

    Attributes:
        name: who predicts.
        start: scenario, `true` or `perturbed`.
        scores: the errors.
        note: what the reader must know to judge the line.
        floor: whether perfect knowledge predicts, and not a model.
        extra: further numbers for metrics.json.
    """

    name: str
    start: str
    scores: Scores
    note: str = ""
    floor: bool = False
    extra: dict[str, Any] = {}  # noqa: RUF012 - never written to


@dataclass
class Findings:
    """What an evaluation reports: table rows, numbers, arrays and figures, each under its own name."""

    rows: list[Row] = field(default_factory=list)
    numbers: dict[str, Any] = field(default_factory=dict)
    arrays: dict[str, Tensor] = field(default_factory=dict)
    figures: dict[str, Figure] = field(default_factory=dict)


class EvaluationPlugin(Protocol):
    """An evaluation that runs after fit; plugins are named in YAML and built from it."""

    def check(self, system: System) -> None:
        """Raise UserError for what does not fit the system; called before anything is trained."""
        ...

    def __call__(self, case: Case) -> Findings:
        """Evaluate a trained model."""
        ...


def perturbations(system: System, count: int, seed: int) -> Tensor:
    """Draw initial errors N(0, P0), shape (count, D), P0 from the system's default noise."""
    generator = torch.Generator().manual_seed(seed)
    noise = torch.randn(count, 2 * system.dof, generator=generator, dtype=torch.float64)
    return noise * system.deviations()

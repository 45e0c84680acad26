"""Input and output of evaluations: the interface between the library and its plugins."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol, runtime_checkable

import torch
from torch import Tensor

from ahnn.integrators import Integrator
from ahnn.measurements import NoiseEstimate, Segment
from ahnn.metrics import Scores, score
from ahnn.shooting.robust import RobustName
from ahnn.systems import System
from ahnn.types import Flow, Space, TimeStep, Trajectories
from ahnn.uncertainty import Uncertainty

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Start = Literal["true", "perturbed", "fitted"]
"""Starts of predictions: the true initial state, one perturbed by N(0, P0), or, if only measurements are
known, the state that best fits them.
"""


@dataclass(frozen=True)
class Case:
    """A trained model and the unseen trajectories of its system; all tensors are float64 on the CPU.

    Attributes:
        label: name of the model in tables.
        assumes: prior knowledge of the dynamics assumed by the model.
        space: description of the state components.
        truth: system with known equations; None: no floors or energy errors.
        flow: the learned flow.
        energy: the learned Hamiltonian, (..., D) -> (...), or None for a model without one.
        integrator: one-step method of the model and of its floor; None for a map.
        dt: sampling interval of the test trajectories, or (B, T - 1) individual steps.
        test: trajectories of the test split.
        validation: trajectories of the validation split.
        train: trajectories of the training split.
        perturbation: (B, D) initial errors of the perturbed start, common to all models; None if P0 is
            unknown.
        folder: output folder.
        measured: measurements of the test trajectories, if training used measurements.
        robust: robust loss of the training.
        learned_from: measurements of the training trajectories, with their first sample.
        uncertainty: covariance of the learned parameters, if available.
        novelty: distance (...) of states (..., D) from the training data, if available.
        fitted: (B, D) starts that best fit the measurements of the test trajectories, if no states are known;
            `test` then contains measurements, NaN where unmeasured or excluded as outliers.
        outliers: fraction of these measurements excluded as outliers.
        noise: noise of the measurements, if estimated in training.
        remark: remark on the test trajectories; "" if they belong to the training data.
        caveat: reason why the training cannot have produced a good model; "" without one.
        shortfall: remark on a training that ended far from its optimum, which counts if residuals are more
            than noise; "" without one.
    """

    label: str
    assumes: str
    space: Space
    truth: System | None
    flow: Flow
    energy: Callable[[Tensor], Tensor] | None
    integrator: Integrator | None
    dt: TimeStep
    test: Trajectories
    validation: Trajectories
    train: Trajectories
    perturbation: Tensor | None
    folder: Path
    measured: Segment | None = None
    robust: RobustName = "none"
    learned_from: Segment | None = None
    uncertainty: Uncertainty | None = None
    novelty: Callable[[Tensor], Tensor] | None = None
    fitted: Tensor | None = None
    outliers: float = 0.0
    noise: NoiseEstimate | None = None
    remark: str = ""
    caveat: str = ""
    shortfall: str = ""

    def starts(self) -> dict[Start, Tensor]:
        """Return the initial states (B, D) by start, as in the paper, or those fitted to measurements."""
        if self.fitted is not None:
            return {"fitted": self.fitted}
        true = self.test.states[:, 0]
        return (
            {"true": true}
            if self.perturbation is None
            else {"true": true, "perturbed": true + self.perturbation}
        )

    @property
    def start(self) -> Start:
        """Start of the plotted rollouts."""
        return "true" if self.fitted is None else "fitted"

    @property
    def longest(self) -> float:
        """Maximum step of the flow: that of the training for recorded measurements, otherwise infinite."""
        return math.inf if self.fitted is None or self.measured is None else self.measured.instrument.longest

    @cached_property
    def true_energy(self) -> Tensor | None:
        """Energy along the test trajectories, (B, T); None without known equations."""
        return None if self.truth is None else self.truth.energy(self.test.states)

    def score(self, prediction: Tensor, first: int = 0) -> Scores:
        """Return the scores of predicted test trajectories, shape (B, T, D), starting at sample `first`."""
        prediction, truth = prediction[:, first:], self.test.states[:, first:]
        energies = None
        if self.truth is not None and self.true_energy is not None:
            energies = self.truth.energy(prediction), self.true_energy[:, first:]
        return score(prediction, truth, energies, self.space.divisor)


class Who(NamedTuple):
    """Identity of a row as separate fields, so that no string has to be parsed.

    Attributes:
        process: process model: `model`, or the name of a floor such as `exact field, rk4`.
        start: start of the prediction.
        estimator: estimator that uses measurements, such as `ukf`; None for a pure prediction.
        span: `whole`, or `settled`: after the first update.
        floor: whether the row is a floor, computed with perfect knowledge.
    """

    process: str
    start: Start
    estimator: str | None = None
    span: Literal["whole", "settled"] = "whole"
    floor: bool = False


class Row(NamedTuple):
    """Row of the results.

    Attributes:
        who: identity of the row.
        scores: errors of the row.
        note: remarks for the interpretation of the row, one finding per line.
        extra: additional numbers for metrics.json.
    """

    who: Who
    scores: Scores
    note: str = ""
    extra: dict[str, Any] = {}  # noqa: RUF012 - never written to


@dataclass
class Findings:
    """Output of an evaluation: named rows, numbers, arrays and figures.

    Attributes:
        notes: findings without a row, attached to the first row of the evaluation.
        faults: findings that need a remedy, for the verdict.
        highlights: additional findings for the verdict.
    """

    rows: list[Row] = field(default_factory=list)
    numbers: dict[str, Any] = field(default_factory=dict)
    arrays: dict[str, Tensor] = field(default_factory=dict)
    figures: dict[str, Figure] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    highlights: list[str] = field(default_factory=list)

    def tell(self, finding: str, also: list[str] | None = None) -> None:
        """Add a finding to the note of the first row, and to `faults` or `highlights`; "" adds nothing."""
        row = self.rows[0]
        self.rows[0] = row._replace(note="\n".join(part for part in (row.note, finding) if part))
        if also is not None and finding:
            also.append(finding)


@runtime_checkable
class EvaluationPlugin(Protocol):
    """Evaluation that runs after training; plugins are configured in YAML."""

    def check(self, truth: System | None, space: Space, steps: int) -> None:
        """Raise UserError for options incompatible with the data; called before training."""
        ...

    def __call__(self, case: Case) -> Findings:
        """Evaluate a trained model."""
        ...


def perturbations(system: System, count: int, seed: int) -> Tensor:
    """Draw initial errors N(0, P0), shape (count, D), with P0 from the system's default noise."""
    generator = torch.Generator().manual_seed(seed)
    noise = torch.randn(count, 2 * system.dof, generator=generator, dtype=torch.float64)
    return noise * system.deviations()

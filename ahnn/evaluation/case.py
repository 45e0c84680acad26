"""What an evaluation works on, and what it finds: the interface between the library and its plugins."""

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
"""Where a prediction begins: at the first true state, at one that is off by N(0, P0), or, where only
measurements are known, at the one from which it meets them best."""


@dataclass(frozen=True)
class Case:
    """A trained model on the unseen trajectories of its system; all tensors float64 on the CPU.

    Attributes:
        label: name of the model in tables.
        assumes: what the model takes as known of the dynamics.
        space: what the numbers mean.
        truth: the system whose equations are known, or None: then there are no floors and no energy errors.
        flow: the learned flow.
        energy: the learned Hamiltonian, (..., D) -> (...), or None for a model without one.
        integrator: one-step method of the model, and of the floor beside it; None for a map.
        dt: sampling interval of the test trajectories, or all of their steps, (B, T - 1), where they differ.
        test: whole trajectories of the split.
        validation: likewise.
        train: likewise.
        perturbation: (B, D) initial errors of the perturbed start, the same for every model; None where no
            P0 is known.
        folder: where results are written.
        measured: measurements of the test trajectories, where training saw nothing else.
        robust: the loss of single residuals that the training took.
        learned_from: measurements of the training trajectories, from their first sample on.
        uncertainty: covariance of the learned parameters, where the training left one.
        novelty: distance (...) of states (..., D) from the training data, where it is known.
        fitted: (B, D) starts from which the model meets the measurements of the test trajectories best, where
            nothing else is known of these: then `test` holds measurements, NaN in what is not measured.
        noise: of the measurements, where the training estimated any.
        remark: what the reader must know of the test trajectories; "" where they are those of the training.
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
    noise: NoiseEstimate | None = None
    remark: str = ""

    def starts(self) -> dict[Start, Tensor]:
        """Return the initial states (B, D) of the starts of the paper, or those fitted to measurements."""
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
        """The start whose rollouts are drawn."""
        return "true" if self.fitted is None else "fitted"

    @property
    def longest(self) -> float:
        """Step of the flow at most; of recorded measurements that of the training, which may lie between."""
        return math.inf if self.fitted is None or self.measured is None else self.measured.instrument.longest

    @cached_property
    def true_energy(self) -> Tensor | None:
        """The energy along the test trajectories, (B, T); None where no equations are known."""
        return None if self.truth is None else self.truth.energy(self.test.states)

    def score(self, prediction: Tensor, first: int = 0) -> Scores:
        """Return the scores of predicted test trajectories, shape (B, T, D), from sample `first` on."""
        prediction, truth = prediction[:, first:], self.test.states[:, first:]
        energies = None
        if self.truth is not None and self.true_energy is not None:
            energies = self.truth.energy(prediction), self.true_energy[:, first:]
        return score(prediction, truth, energies, self.space.divisor)


class Who(NamedTuple):
    """Identity of a row: never a string to be cut.

    Attributes:
        process: the flow that predicts, `model`, or the name of a floor such as `exact field, rk4`.
        start: where it begins.
        estimator: what assimilates measurements, such as `ukf`; None for a prediction without any.
        span: `whole`, or `settled`: from the first update on.
        floor: whether perfect knowledge predicts, and not a model.
    """

    process: str
    start: Start
    estimator: str | None = None
    span: Literal["whole", "settled"] = "whole"
    floor: bool = False


class Row(NamedTuple):
    """A line of the results.

    Attributes:
        who: its identity.
        scores: the errors.
        note: what the reader must know to judge the line, each finding on a line of its own.
        extra: further numbers for metrics.json.
    """

    who: Who
    scores: Scores
    note: str = ""
    extra: dict[str, Any] = {}  # noqa: RUF012 - never written to


@dataclass
class Findings:
    """What an evaluation reports: rows, numbers, arrays and figures, each under its own name.

    Attributes:
        notes: findings without a row of their own, which go to the first one of the evaluation.
        faults: findings that ask for a remedy, for the verdict.
        highlights: further findings for the verdict.
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
    """An evaluation that runs after fit; plugins are named in YAML and built from it."""

    def check(self, truth: System | None, space: Space, steps: int) -> None:
        """Raise UserError for what does not fit the data; called before anything is trained."""
        ...

    def __call__(self, case: Case) -> Findings:
        """Evaluate a trained model."""
        ...


def perturbations(system: System, count: int, seed: int) -> Tensor:
    """Draw initial errors N(0, P0), shape (count, D), P0 from the system's default noise."""
    generator = torch.Generator().manual_seed(seed)
    noise = torch.randn(count, 2 * system.dof, generator=generator, dtype=torch.float64)
    return noise * system.deviations()

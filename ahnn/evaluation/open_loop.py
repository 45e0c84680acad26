"""Open-loop prediction without measurements, with the floors of perfect knowledge."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.evaluation.case import Case, Findings, Row, Start, Who
from ahnn.evaluation.titles import MODEL, described
from ahnn.integrators import INTEGRATORS, Integrator
from ahnn.rollouts import clock_of, rollout
from ahnn.systems import System, exact_flow
from ahnn.types import Flow, TimeStep


class Floor(NamedTuple):
    """Floor: perfect knowledge in place of a model.

    Attributes:
        who: identity of the floor's row in the results.
        flow: the exact flow, or the exact field with an integrator.
    """

    who: Who
    flow: Flow


class Integrated(NamedTuple):
    """Flow of the true field with an integrator."""

    system: System
    integrator: Integrator

    @property
    def clock(self) -> int:
        """Number of clock coordinates of its states."""
        return self.system.clock

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states after dt."""
        return self.integrator.step(self.system, x, dt)


def floors(case: Case) -> dict[Start, Floor]:
    """Return the floor of each start of a case; empty without known equations.

    From the true start the floor is the exact field with the model's integrator (rk4 for a map); its error is
    that of the integrator. From the perturbed start it is the exact flow; its error is that of the
    perturbation, which no model can avoid.
    """
    if case.truth is None:
        return {}
    own = case.integrator or INTEGRATORS["rk4"]
    field = Floor(
        Who(f"exact field, {own.name}", "true", floor=True),
        Integrated(case.truth, own),
    )
    flow = Floor(Who("exact flow", "perturbed", floor=True), exact_flow(case.truth))
    found: dict[Start, Floor] = {"true": field, "perturbed": flow}
    return {start: found[start] for start in case.starts()}


def open_loop(case: Case) -> Findings:
    """Roll out the model and the floors from every start of a case."""
    findings = Findings()
    samples, starts, there = case.test.states.shape[1], case.starts(), floors(case)
    # All starts in one batch: for small models, a step on twice as many states costs no more.
    together = torch.cat(list(starts.values()))
    text = described(Who(MODEL, case.start), case.label)
    dt = case.dt.repeat(len(starts), 1) if isinstance(case.dt, Tensor) else case.dt
    clock = case.test.clock(clock_of(case.flow))
    clock = clock and clock.rows(torch.arange(len(case.test.times)).repeat(len(starts)))
    predictions = rollout(case.flow, together, dt, samples, text, case.longest, clock=clock)
    predictions = predictions.chunk(len(starts))
    for start, prediction in zip(starts, predictions, strict=True):
        who = Who(MODEL, start)
        findings.arrays[f"{start}_start"] = prediction
        lost = _lost(case, prediction)
        note = f"diverged: {lost} of {len(prediction)} predictions run to infinity" if lost else ""
        extra = _drift(case.energy, prediction) | {"lost": lost / len(prediction)}
        extra |= {"outliers": case.outliers} if case.outliers else {}
        findings.rows.append(Row(who, case.score(prediction), note, extra))
    for start, floor in there.items():
        clock = case.test.clock(clock_of(floor.flow))
        text = described(floor.who, case.label)
        prediction = rollout(floor.flow, starts[start], case.dt, samples, text, clock=clock)
        findings.arrays[f"floor_{start}_start"] = prediction
        findings.rows.append(Row(floor.who, case.score(prediction)))
    return findings


def _lost(case: Case, prediction: Tensor) -> int:
    """Return the number of predictions (B, T, D) from known starts with non-finite errors."""
    wrong = ~prediction.square().sum(-1).isfinite() & case.test.times.isfinite()
    return int((wrong.any(1) & ~wrong[:, 0]).sum())


def _drift(energy: Callable[[Tensor], Tensor] | None, prediction: Tensor) -> dict[str, float]:
    """Return the rms over trajectories and times of H_theta(x^_k) - H_theta(x^_0); {} without H_theta."""
    if energy is None:
        return {}
    values = energy(prediction)
    return {"learned_energy_drift": float((values - values[:, :1]).square().mean().sqrt())}

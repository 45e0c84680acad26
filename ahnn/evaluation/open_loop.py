"""Prediction without measurements, beside what perfect knowledge would score in the same setting."""

from __future__ import annotations

from torch import Tensor

from ahnn.evaluation.case import Case, Findings, Row
from ahnn.integrators import INTEGRATORS, Integrator
from ahnn.rollouts import rollout
from ahnn.systems import System
from ahnn.types import Flow, TimeStep


def exact_flow(system: System, integrator: Integrator) -> Flow:
    """Return the flow of the true field through an integrator."""

    def flow(x: Tensor, dt: TimeStep) -> Tensor:
        return integrator.step(system, x, dt)

    return flow


def open_loop(case: Case) -> Findings:
    """Roll the model out from the true and the perturbed start, and the floors beside it.

    The floors: the exact field through the model's integrator (what the integrator costs), and the exact flow
    from the perturbed start (what the perturbation costs; no model can be blamed for less).
    """
    findings = Findings()
    dt, samples = case.test.dt, case.test.states.shape[1]
    reference = INTEGRATORS[case.system.integrator]
    starts = case.starts()
    for scenario, start in starts.items():
        prediction = rollout(case.flow, start, dt, samples, f"{case.label} from the {scenario} start")
        findings.arrays[f"{scenario}_start"] = prediction
        extra = {"learned_energy_drift": _drift(case, prediction)} if case.learned_energy else {}
        findings.rows.append(Row(case.label, scenario, case.score(prediction), extra=extra))
    floors = (
        ("true", case.integrator, f"exact field, {case.integrator.name}"),
        ("perturbed", reference, "exact flow"),
    )
    for scenario, integrator, name in floors:
        prediction = rollout(exact_flow(case.system, integrator), starts[scenario], dt, samples)
        findings.arrays[f"floor_{scenario}_start"] = prediction
        findings.rows.append(Row(name, scenario, case.score(prediction), floor=True))
    return findings


def _drift(case: Case, prediction: Tensor) -> float:
    """Return the rms over trajectories and times of H_theta(x^_k) - H_theta(x^_0), in the system's energy."""
    energy = case.learned_energy(prediction)
    return float((energy - energy[:, :1]).square().mean().sqrt())

"""The filter as an evaluation of a trained model; `plugins=ukf`."""

from __future__ import annotations

from typing import Any, Literal, final

import torch
from torch import Tensor

from ahnn.arguments import check_arguments
from ahnn.errors import UserError
from ahnn.evaluation import Case, Findings
from ahnn.evaluation.open_loop import exact_flow
from ahnn.evaluation.rollout import rollout
from ahnn.integrators import INTEGRATORS
from ahnn.systems import System
from ahnn_plugins.ukf.figures import ukf_figures
from ahnn_plugins.ukf.measurements import Measurement, Position
from ahnn_plugins.ukf.outcome import Outcome, filtered, numbers, rows, smoothed
from ahnn_plugins.ukf.process_noise import fitted_process_noise
from ahnn_plugins.ukf.scenario import (
    Filter,
    Problem,
    Setting,
    assimilate,
    shown,
    simulated,
    validation_problem,
)
from ahnn_plugins.ukf.square_root import SQUARE_ROOT
from ahnn_plugins.ukf.standard import STANDARD
from ahnn_plugins.ukf.tuning import Tuning, tuned_once
from ahnn_plugins.ukf.types import Gate, UnscentedParameters

FITTING = 20
"""Validation trajectories on which the scale of Q is chosen."""


@final
class UKFEvaluation:
    """Unscented Kalman filter with the model as its process model, beside one with the exact dynamics.

    Two scenarios, `true` and `perturbed` start, see noisy measurements of the test trajectories; the noise is
    drawn from the seed alone, so that all models see the same. P0 is the system's own.

    Args:
        cadence: steps between two measurements.
        measurement: what is measured; None takes the positions.
        measurement_sd: standard deviation of each measured component, or one for all; None takes the system's
            own for positions.
        process_noise: `fitted` to validation data, or standard deviations [position, velocity] of the error
            of one step.
        alpha, beta, kappa: parameters of the sigma points.
        form: how covariances are carried.
        gate: probability beyond which a measurement is refused as an outlier; None takes all.
        smoother: whether to add the rows of the Rauch-Tung-Striebel smoother.
        tuning: options of `Tuning`, to add the rows of a tuned filter; None leaves them out.
        seed: of measurement noise and of the validation arcs.
    """

    def __init__(
        self,
        *,
        cadence: int,
        measurement: Measurement | dict[str, Any] | None,
        measurement_sd: float | list[float] | None,
        process_noise: Literal["fitted"] | list[float],
        alpha: float,
        beta: float,
        kappa: float,
        form: Literal["square_root", "standard"],
        gate: float | None,
        smoother: bool,
        tuning: dict[str, Any] | None,
        seed: int,
    ) -> None:
        if isinstance(measurement, dict):
            message = (
                f"plugins.ukf.measurement: expected null or a node with _target_; received keys "
                f"{', '.join(measurement)}"
            )
            raise UserError(message)
        self.cadence, self.seed, self.smoother = cadence, seed, smoother
        self.measurement, self.measurement_sd = measurement, measurement_sd
        self.process_noise = process_noise
        self.parameters = UnscentedParameters(alpha, beta, kappa)
        self.form = {"square_root": SQUARE_ROOT, "standard": STANDARD}[form]
        self.gate = None if gate is None else Gate(gate)
        self.tuning = None
        if tuning is not None:
            check_arguments("plugins.ukf.tuning", Tuning, tuning)
            self.tuning = Tuning(**tuning)
        self._check()

    def _check(self) -> None:
        if self.cadence < 1:
            message = f"plugins.ukf.cadence: expected at least 1 step; received {self.cadence}"
            raise UserError(message)
        if self.gate is not None and not 0 < self.gate.probability < 1:
            message = f"plugins.ukf.gate: expected a probability in (0, 1); received {self.gate.probability}"
            raise UserError(message)
        noise = self.process_noise
        if isinstance(noise, list) and (len(noise) != 2 or min(noise) < 0):
            message = (
                f"plugins.ukf.process_noise: expected `fitted` or two standard deviations [position, "
                f"velocity] >= 0; received {noise}"
            )
            raise UserError(message)

    @torch.no_grad()
    def __call__(self, case: Case) -> Findings:
        """Filter the test trajectories and report scores, consistency and figures."""
        setting = self._setting(case)
        findings = Findings(numbers=self._settings(setting))
        problems = self._problems(case, setting)
        outcomes: list[Outcome] = []
        for chosen in self._filters(case, setting, findings):
            for start, problem in problems.items():
                outcomes += self._outcomes(chosen, setting, problem, start)
        dt, samples = case.test.dt, case.test.states.shape[1]
        without = {start: rollout(case.flow, p.starts, dt, samples) for start, p in problems.items()}
        scores = {start: case.score(prediction) for start, prediction in without.items()}
        findings.numbers["filters"] = {}
        for outcome in outcomes:
            findings.rows += rows(outcome, case, None if outcome.floor else scores[outcome.start])
            entry = findings.numbers["filters"].setdefault(outcome.name, {})
            entry[outcome.start] = numbers(outcome, case)
        findings.arrays, findings.figures = ukf_figures(case, setting, outcomes, without)
        return findings

    def _outcomes(self, chosen: Filter, setting: Setting, problem: Problem, start: str) -> list[Outcome]:
        """Return what comes of a filter, and of its smoother if asked for, in one scenario."""
        text, steps = f"{chosen.name} from the {start} start", problem.measurements.shape[1]
        with shown(chosen.flow, text, steps) as flow:
            result = assimilate(chosen._replace(flow=flow), setting, problem, smoothing=self.smoother)
        outcomes = [filtered(chosen, setting, problem, start, result)]
        if self.smoother:
            outcomes.append(smoothed(chosen, setting, problem, start, result))
        return outcomes

    def _filters(self, case: Case, setting: Setting, findings: Findings) -> list[Filter]:
        """Return the filters of the table: the model's, tuned if asked for, and the floor."""
        r, size = setting.measurement_noise, case.test.states.shape[-1]
        nothing = torch.zeros(size, size, dtype=torch.float64)
        model = Filter(f"{case.label} + UKF", case.flow, nothing, r, self.parameters)
        model = model._replace(process_noise=self._process_noise(case, setting, model, findings))
        filters = [model]
        if self.tuning is not None:
            options = self.tuning
            count = min(options.trajectories, len(case.validation.states))
            arcs = validation_problem(setting, case.validation, count, options.steps, self.seed + 3)
            tuned = tuned_once(model, setting, arcs, options, case.folder / "ukf_tuned.json")
            findings.numbers["tuning"] = tuned._asdict()
            filters.append(tuned.apply(model)._replace(name=f"{case.label} + UKF tuned"))
        exact = exact_flow(case.system, INTEGRATORS[case.system.integrator])
        return [*filters, Filter("exact flow + UKF", exact, nothing, r, self.parameters, floor=True)]

    def _process_noise(self, case: Case, setting: Setting, model: Filter, findings: Findings) -> Tensor:
        """Return Q of the model and write down where it comes from."""
        if isinstance(self.process_noise, list):
            position, velocity = self.process_noise
            blocks = torch.tensor([position, velocity * case.system.inertia], dtype=torch.float64)
            q = torch.diag(blocks.repeat_interleave(case.system.dof) ** 2)
            about: dict[str, Any] = {"from": "given"}
        else:
            count = min(FITTING, len(case.validation.states))
            arcs = validation_problem(setting, case.validation, count, None, self.seed + 1)
            fitted = fitted_process_noise(model, setting, arcs, case.validation)
            q = fitted.covariance
            about = {"from": "fitted", "scale": fitted.scale, "nees_of_scales": list(fitted.nees)}
        findings.numbers["process_noise"] = {**about, "step_sd": q.diagonal().sqrt().tolist()}
        return q

    def _problems(self, case: Case, setting: Setting) -> dict[str, Problem]:
        """Return the scenarios; both see the same measurements."""
        measurements = simulated(setting, case.test.states, case.test.dt, self.seed)
        starts = case.starts().items()
        return {
            start: Problem(case.test.states, states, measurements, case.test.dt) for start, states in starts
        }

    def _setting(self, case: Case) -> Setting:
        """Return measurements and P0 of a case.

        Raises:
            UserError: no measurement falls within a trajectory, or they do not fit the system.
        """
        steps = min(int(part.lengths.min()) - 1 for part in (case.test, case.validation))
        if self.cadence > steps:
            message = (
                f"plugins.ukf.cadence: expected at most {steps}, the steps of a trajectory; received "
                f"{self.cadence}"
            )
            raise UserError(message)
        alpha, _, kappa = self.parameters
        if alpha == 0 or kappa <= -2 * case.system.dof:
            message = (
                f"plugins.ukf: expected alpha other than 0 and kappa > {-2 * case.system.dof}; "
                f"received alpha={alpha} and kappa={kappa}"
            )
            raise UserError(message)
        measurement = self.measurement or Position(case.system.dof, case.system.units.position)
        sd = self._deviations(case.system, measurement)
        _check_measurement(measurement, case.test.states[:1, 0])
        return Setting(measurement, sd, case.system.deviations(), self.cadence, self.form, self.gate)

    def _deviations(self, system: System, measurement: Measurement) -> Tensor:
        """Return the standard deviations of the measurement noise, (M,)."""
        given = self.measurement_sd
        if given is None and self.measurement is None:
            given = system.noise.measurement
        names = [f"{n} [{u}]" for n, u in zip(measurement.names, measurement.units, strict=True)]
        values = given if isinstance(given, list) else [given or 0.0] * len(names)
        if len(values) != len(names) or min(values) <= 0:
            message = (
                f"plugins.ukf.measurement_sd: expected one number > 0 for each of {', '.join(names)}; "
                f"received {given}"
            )
            raise UserError(message)
        return torch.tensor(values, dtype=torch.float64)

    def _settings(self, setting: Setting) -> dict[str, Any]:
        """Return what was assumed, for metrics.json."""
        return {
            "cadence": setting.cadence,
            "measured": list(setting.measurement.names),
            "measurement_sd": setting.measurement_sd.tolist(),
            "start_sd": setting.start_sd.tolist(),
            "form": setting.form.name,
            "parameters": self.parameters._asdict(),
            "seed": self.seed,
        }


def _check_measurement(measurement: Measurement, x: Tensor) -> None:
    """Try a measurement model on a state, (1, D).

    Raises:
        UserError: it does not take states of this size.
    """
    expected = (1, len(measurement.names))
    try:
        shape = tuple(measurement(x, 0.0).shape)
    except (RuntimeError, IndexError, ValueError) as error:
        message = (
            f"plugins.ukf.measurement: expected a model of states with {x.shape[-1]} components; "
            f"{type(measurement).__name__} failed: {error}"
        )
        raise UserError(message) from error
    if shape != expected:
        message = f"plugins.ukf.measurement: expected measurements {expected}; received {shape}"
        raise UserError(message)

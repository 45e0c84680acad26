"""Evaluation plugin that runs an estimator on a trained model: config group `plugins`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, Literal, cast

import torch
from torch import Tensor

from ahnn.arguments import Count, Positive, Within, checked
from ahnn.errors import UserError
from ahnn.estimation.covariances import initial_belief
from ahnn.estimation.estimator import Estimator
from ahnn.estimation.gate import Gate
from ahnn.estimation.online import online_process, weights_hash
from ahnn.estimation.process_model import Process
from ahnn.estimation.scenario import Problem, Setting, perturbed_arcs, simulated
from ahnn.estimation.setting import make_setting, near_system, require_measurement
from ahnn.estimation.trial import Filter, assimilate, assimilate_all, shown
from ahnn.evaluation.case import Case, Findings, Start, Who
from ahnn.evaluation.estimators.filter_figures import filter_figures
from ahnn.evaluation.estimators.noise_options import (
    ForceOptions,
    GivenNoise,
    Noise,
    NoiseOption,
    ParameterOptions,
    given_noise,
    grown,
    noise_option,
    require_truth,
    with_process_noise,
    without_parameters,
)
from ahnn.evaluation.estimators.outcome import Outcome, filtered, fitted, numbers, rows, smoothed
from ahnn.evaluation.estimators.probe import require_possible
from ahnn.evaluation.estimators.series import moving_averages
from ahnn.evaluation.estimators.smoother_option import asked_smoothers
from ahnn.evaluation.titles import MODEL, described, estimator_title
from ahnn.measurements import Measurement
from ahnn.rollouts import clock_of, rollout
from ahnn.systems import System, exact_flow
from ahnn.types import Flow, Space
from ahnn.uncertainty import Uncertainty

Bias = float | list[float] | None
"""Parameters of sensor biases, see `ahnn.measurements.Biases`."""


@checked
class EstimatorEvaluation:
    """Evaluation of an estimator with the model as process model, and with the exact dynamics.

    Two scenarios, `true` and `perturbed` start, use noisy measurements of the test trajectories; the noise
    depends only on the seed, so that all models and estimators receive the same measurements.

    Args:
        estimator: estimator without a gate.
        cadence: steps between two measurements.
        times: measurement times, as an alternative to the cadence.
        measurement: `position`, `state`, or a measurement model.
        measurement_sd: standard deviation of each measured component, or a common one; None for the system's
            default, for positions.
        bias_sd: standard deviations of measurement biases, common or per component, 0 for no bias: biases are
            simulated, and estimated with the state. None: no biases.
        bias_memory: time constants of drifting biases or coloured noise; None for constant biases.
        start_sd: standard deviations of the initial error, for P0: one for each component, or one for
            positions and one for velocities; None for the system's default for perturbed starts.
        process_noise: `fitted` to validation data; standard deviations [position, velocity] of the error
            of one step; `force_error`, relative and with memory, or `{size: ..., memory: ...}` to fix either;
            or `parameter_error`: learned parameters as filter states, with their covariance as prior.
        novelty: growth rate of the force error with the square of novelty - 1, such as 500; None: no growth.
            Requires `force_error` or `parameter_error`.
        gate: probability of the chi-square gate for outliers; None: no gate.
        patience: number of consecutive rejections after which a member counts as diverged.
        smoother: whether to add the smoother's rows; a name adds the rows of all smoothers up to it.
        least_squares: whether to add the rows of batch least squares.
        seed: seed for the measurement noise and the validation arcs.
        beside: a similar system for data with unknown equations: its exact flow is filtered for comparison,
            with its own process noise, and the system provides defaults.
    """

    def __init__(
        self,
        estimator: Estimator[Any],
        *,
        cadence: Count,
        times: list[float] | None,
        measurement: Measurement | dict[str, Any] | Literal["position", "state"],
        measurement_sd: Positive | list[Positive] | None,
        bias_sd: Bias = None,
        bias_memory: Bias = None,
        start_sd: list[Positive] | None,
        process_noise: GivenNoise,
        novelty: Annotated[float, Within(0)] | None = None,
        gate: Annotated[float, Within(above=0, below=1)] | None,
        patience: Count,
        smoother: bool | str,
        least_squares: bool,
        seed: int,
        beside: System | None = None,
    ) -> None:
        require_measurement(measurement)
        self.beside, self.seed, self.least_squares = beside, seed, least_squares
        self.patience = patience  # also used by the gate of a stream
        self.estimator = estimator.gated(None if gate is None else Gate(gate, patience))
        self.smoothers = asked_smoothers(smoother, self.estimator)
        self.process_noise: NoiseOption = noise_option(process_noise)
        self.novelty = novelty
        if novelty is not None and not isinstance(self.process_noise, ForceOptions | ParameterOptions):
            message = (
                f"novelty: expected process_noise=force_error or parameter_error; received {process_noise}"
            )
            raise UserError(message)
        self._setting = partial(
            make_setting,
            measurement=cast(Any, measurement),
            measurement_sd=measurement_sd,
            bias_sd=bias_sd,
            bias_memory=bias_memory,
            start_sd=start_sd,
            cadence=cadence,
            times=times,
        )

    def check(self, truth: System | None, space: Space, steps: int) -> None:
        """Check the options against the data, before any training.

        Args:
            truth: system with known equations, or None.
            space: description of the state components.
            steps: number of steps of the shortest test trajectory.

        Raises:
            UserError: an option is incompatible; the message names it.
        """
        system = near_system(truth, self.beside, space)
        setting = self._setting(system, steps)
        option = self.process_noise
        added = option.added(system.dof) if isinstance(option, ForceOptions | ParameterOptions) else 0
        added += 0 if setting.sensor_error is None else setting.sensor_error.added
        self.require_constants(setting, steps, 2 * system.dof + added)
        require_possible(setting, system, option, self.estimator)

    def require_constants(self, setting: Setting, steps: int, size: int) -> None:
        """Check that the estimator's constants are valid for states of a given maximum size."""
        self.estimator.start(initial_belief(torch.zeros(1, size), torch.eye(size)))

    def tried(
        self, model: Filter, case: Case, setting: Setting, findings: Findings
    ) -> list[tuple[Who, Filter]]:
        """Return further filters of the model, such as a tuned one."""
        return []

    @torch.no_grad()
    def __call__(self, case: Case) -> Findings:
        """Filter the test trajectories and report scores, consistency and figures."""
        shortest = min(int(part.present.sum(-1).min()) - 1 for part in (case.test, case.validation))
        self.check(case.truth, case.space, shortest)
        setting = self._setting(near_system(case.truth, self.beside, case.space), shortest)
        findings = Findings(numbers=self.settings(setting))
        problems = self._problems(case, setting)
        outcomes: list[Outcome] = []
        for who, chosen in self._filters(case, setting, findings):
            for start, problem in problems.items():
                outcomes += self._outcomes(who._replace(start=start), chosen, case, setting, problem)
        samples, clock = case.test.states.shape[1], case.test.clock(clock_of(case.flow))
        without: dict[Start, Tensor] = {
            start: rollout(case.flow, problem.starts, case.dt, samples, case.label, clock=clock)
            for start, problem in problems.items()
        }
        scores = {start: case.score(prediction) for start, prediction in without.items()}
        findings.numbers["filters"] = {}
        floors = {(o.who.estimator, o.who.start): case.score(o.estimate) for o in outcomes if o.who.floor}
        for outcome in outcomes:
            who = outcome.who
            compared = scores[who.start] if who.process == MODEL else None
            findings.rows += rows(outcome, case, compared, floors.get((who.estimator, who.start)))
            several = findings.numbers["filters"].setdefault(who.estimator, {})
            entry = several.setdefault("floor" if who.floor else who.process, {})
            entry[who.start] = numbers(outcome, case) | moving_averages(outcome, case)
        findings.arrays, findings.figures = filter_figures(case, setting, outcomes, without)
        return findings

    def online(
        self,
        flow: Flow,
        interval: float,
        space: Space,
        case: Callable[[], Case],
        novelty: Callable[[Tensor], Tensor] | None = None,
        known: Uncertainty | None = None,
    ) -> Process:
        """Build the online process of the estimator, with the configured process noise.

        Args:
            flow: process model.
            interval: sampling interval of the training data.
            space: description of the state components.
            case: function that returns the data for fits of process noise; called only if needed.
            novelty: distance (...) of states (..., D) from the training data, if available.
            known: covariance of the parameters, if available.

        Raises:
            UserError: the novelty or parameter covariance is required but unknown.
        """
        noise = given_noise(self.process_noise, space, grown(novelty, self.novelty), flow, known)
        if noise is None:
            noise = self._found(case())
        about = {"space": space.name, "flow": weights_hash(flow), "novelty": self.novelty}
        return online_process(self.estimator, flow, interval, *noise, about)

    @torch.no_grad()
    def _found(self, case: Case) -> Noise:
        """Fit the process noise to validation data."""
        require_truth(self.process_noise, case.truth or self.beside)
        shortest = int(case.validation.present.sum(-1).min()) - 1
        setting = self._setting(near_system(case.truth, self.beside, case.space), shortest)
        (_, model), *_ = self._filters(case, setting, Findings())
        return model.process_noise, model.force_error

    def _outcomes(
        self, who: Who, chosen: Filter, case: Case, setting: Setting, problem: Problem
    ) -> list[Outcome]:
        """Return the outcomes of a filter, and of its smoothers if requested, in one scenario."""
        with shown(chosen.flow, described(who, case.label), problem.measurements.shape[1]) as flow:
            chosen = chosen._replace(flow=flow)
            if not (self.smoothers or self.least_squares):
                return [filtered(who, setting, problem, assimilate(chosen, setting, problem))]
            options = self.smoothers, self.least_squares
            result, behind = assimilate_all(chosen, setting, problem, options[0], batch=options[1])
        outcomes = [filtered(who, setting, problem, result)]
        outcomes += [smoothed(who, setting, problem, result, *found) for found in behind.smoothed.items()]
        if behind.batch is not None:
            outcomes.append(fitted(who, setting, problem, behind.batch))
        return outcomes

    def _filters(self, case: Case, setting: Setting, findings: Findings) -> list[tuple[Who, Filter]]:
        """Return the filters of the table: the model's filter, its variants, and the floor."""
        r, size = setting.measurement_noise, case.test.states.shape[-1]
        nothing = torch.zeros(size, size, dtype=torch.float64)
        name = self.estimator.name
        plain = Filter(f"{case.label} + {estimator_title(name)}", case.flow, nothing, r, self.estimator)

        def arcs(count: int) -> Problem:
            return self.arcs(case, setting, count, None, self.seed + 1)

        model, about = with_process_noise(self.process_noise, plain, case, setting, arcs, self.novelty)
        findings.numbers["process_noise"] = about
        filters = [(Who(MODEL, "true", name), model), *self.tried(model, case, setting, findings)]
        if case.truth is not None:
            exact = exact_flow(case.truth)
            floor = plain._replace(name=f"exact flow + {estimator_title(name)}", flow=exact)
            filters.append((Who("exact flow", "true", name, floor=True), floor))
        if self.beside is not None:
            other = f"{self.beside.name} + {estimator_title(name)}"
            other = plain._replace(name=other, flow=exact_flow(self.beside))
            option = without_parameters(self.process_noise)
            other, about = with_process_noise(option, other, case, setting, arcs)
            findings.numbers["process_noise_beside"] = about
            filters.append((Who(self.beside.name, "true", name), other))
        return filters

    def arcs(self, case: Case, setting: Setting, count: int, steps: int | None, seed: int) -> Problem:
        """Return arcs of some validation trajectories, for tuning and for fits of process noise."""
        if steps is not None and clock_of(case.flow):  # arcs may begin at any time, filters begin at zero
            message = f"tuning.steps: expected null with forces that depend on time; received {steps}"
            raise UserError(message)
        data = case.validation
        given = setting, data.states, _interval(case), min(count, len(data.states)), steps, seed
        return perturbed_arcs(*given, data.controls, linear=data.linear)

    def _problems(self, case: Case, setting: Setting) -> dict[Start, Problem]:
        """Build the scenarios, which share the same measurements."""
        truth, dt, data = case.test.states, _interval(case), case.test
        measurements = simulated(setting, truth, dt, self.seed)
        known = measurements, dt, data.controls, data.linear
        return {start: Problem(truth, x, *known) for start, x in case.starts().items()}

    def settings(self, setting: Setting) -> dict[str, Any]:
        """Return the filter's assumptions, for metrics.json."""
        return {
            "updates": list(setting.updates),
            "measured": list(setting.measurement.names),
            "measurement_sd": setting.measurement_sd.tolist(),
            "bias": None if setting.sensor_error is None else setting.sensor_error.about,
            "start_sd": setting.start_sd.tolist(),
            "seed": self.seed,
        }


def _interval(case: Case) -> float:
    """Return the time step, which all simulated trajectories share."""
    assert isinstance(case.dt, float), "simulated trajectories have one step"
    return case.dt

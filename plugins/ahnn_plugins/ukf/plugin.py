"""The filter as an evaluation of a trained model; `plugins=ukf`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, Literal, cast, final

import torch
from torch import Tensor

from ahnn.arguments import Count, Finite, Positive, Within, check_arguments, checked
from ahnn.assimilation import Process
from ahnn.errors import UserError
from ahnn.estimation.gate import Gate
from ahnn.estimation.scenario import Problem, Setting, perturbed_arcs, simulated
from ahnn.evaluation import Case, Findings, Who
from ahnn.evaluation.case import Start
from ahnn.evaluation.titles import MODEL, described
from ahnn.measurements import Measurement
from ahnn.rollouts import rollout
from ahnn.systems import System, exact_flow
from ahnn.types import Flow, Space
from ahnn.uncertainty import Uncertainty
from ahnn_plugins.ukf.assimilation import Filter, assimilate, assimilate_all, shown
from ahnn_plugins.ukf.estimator import UnscentedKalmanFilter
from ahnn_plugins.ukf.figures import ukf_figures
from ahnn_plugins.ukf.noise_options import (
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
from ahnn_plugins.ukf.online import online_process, weights_hash
from ahnn_plugins.ukf.outcome import Outcome, filtered, fitted, iterated, numbers, rows, smoothed
from ahnn_plugins.ukf.probe import require_possible
from ahnn_plugins.ukf.regression import regression_weights
from ahnn_plugins.ukf.series import moving_averages
from ahnn_plugins.ukf.setting import make_setting, near_system, require_measurement
from ahnn_plugins.ukf.sigma_points import unscented_weights
from ahnn_plugins.ukf.square_root import SQUARE_ROOT
from ahnn_plugins.ukf.standard import STANDARD
from ahnn_plugins.ukf.tuning import Tuning, tuned_once
from ahnn_plugins.ukf.types import UnscentedParameters


@final
@checked
class UKFEvaluation:
    """Unscented Kalman filter with the model as its process model, beside one with the exact dynamics.

    Two scenarios, `true` and `perturbed` start, see noisy measurements of the test trajectories; the noise is
    drawn from the seed alone, so that all models see the same.

    Args:
        cadence: steps between two measurements.
        times: of the measurements, in place of a cadence; None takes the cadence.
        measurement: what is measured: `position`, `state`, or a model of its own.
        measurement_sd: standard deviation of each measured component, or one for all; None takes the system's
            own for positions.
        start_sd: standard deviations of the initial error [position, velocity], for P0; None takes the
            system's own, those that perturbed starts are drawn with.
        process_noise: `fitted` to validation data; standard deviations [position, velocity] of the error
            of one step; `force_error`, relative and with memory, `{size: ..., memory: ...}` where one of
            them is given; or `parameter_error`: the learned parameters are states of the filter, known as
            their covariance says.
        novelty: rate by which the force error grows with the square of novelty - 1, such as 500; None
            lets it not. It needs `force_error` or `parameter_error`.
        alpha, beta, kappa: parameters of the sigma points.
        form: how covariances are carried.
        gate: probability beyond which a measurement is refused as an outlier; None takes all.
        patience: refusals in a row after which a member has diverged.
        smoother: whether to add the rows of the smoother; `iterated` adds those of the iterated one too.
        least_squares: whether to add the rows of batch least squares.
        tuning: options of `Tuning`, to add the rows of a tuned filter; None leaves them out.
        seed: of measurement noise and of the validation arcs.
        beside: a system that is near the data where their own equations are not known: it filters beside the
            model, with process noise of its own, and its defaults are taken.
    """

    def __init__(
        self,
        *,
        cadence: Count,
        times: list[float] | None,
        measurement: Measurement | dict[str, Any] | Literal["position", "state"],
        measurement_sd: Positive | list[Positive] | None,
        start_sd: tuple[Positive, Positive] | None,
        process_noise: GivenNoise,
        novelty: Annotated[float, Within(0)] | None = None,
        alpha: Finite,
        beta: Finite,
        kappa: Finite,
        form: Literal["square_root", "standard"],
        gate: Annotated[float, Within(above=0, below=1)] | None,
        patience: Count,
        smoother: bool | Literal["iterated"],
        least_squares: bool,
        tuning: dict[str, Any] | None,
        seed: int,
        beside: System | None = None,
    ) -> None:
        require_measurement(measurement)
        self.beside = beside
        self.seed, self.smoother, self.least_squares = seed, smoother, least_squares
        self.process_noise: NoiseOption = noise_option(process_noise)
        self.novelty = novelty
        if novelty is not None and not isinstance(self.process_noise, ForceOptions | ParameterOptions):
            message = f"novelty: expected a force_error or parameter_error; received {process_noise}"
            raise UserError(message)
        self.parameters = UnscentedParameters(alpha, beta, kappa)
        self.form = {"square_root": SQUARE_ROOT, "standard": STANDARD}[form]
        self.gate = None if gate is None else Gate(gate, patience)
        self.tuning = None
        if tuning is not None:
            check_arguments("tuning", Tuning, tuning)
            self.tuning = Tuning(**tuning)
        self._setting = partial(
            make_setting,
            measurement=cast(Any, measurement),
            measurement_sd=measurement_sd,
            start_sd=start_sd,
            cadence=cadence,
            times=times,
        )

    def check(self, truth: System | None, space: Space, steps: int) -> None:
        """Refuse what does not fit the data, before anything is trained on them.

        Args:
            truth: the system whose equations are known, or None.
            space: what the numbers mean.
            steps: of the shortest test trajectory.

        Raises:
            UserError: says which option.
        """
        system = near_system(truth, self.beside, space)
        setting = self._setting(system, steps)
        if self.tuning is not None and (self.tuning.steps or steps) < setting.first:
            first = f"{setting.first}, when the first measurement comes"
            message = f"tuning.steps: expected at least {first}; received {self.tuning.steps}"
            raise UserError(message)
        option, size = self.process_noise, 2 * system.dof
        added = option.added(system.dof) if isinstance(option, ForceOptions | ParameterOptions) else 0
        weights = regression_weights if self.smoother == "iterated" else unscented_weights
        weights(self.parameters, size + added)
        require_possible(setting, system, option, self.parameters, self.form, self.gate)

    @torch.no_grad()
    def __call__(self, case: Case) -> Findings:
        """Filter the test trajectories and report scores, consistency and figures."""
        shortest = min(int(part.present.sum(-1).min()) - 1 for part in (case.test, case.validation))
        self.check(case.truth, case.space, shortest)
        setting = self._setting(near_system(case.truth, self.beside, case.space), shortest)
        findings = Findings(numbers=self._settings(setting))
        problems = self._problems(case, setting)
        outcomes: list[Outcome] = []
        for who, chosen in self._filters(case, setting, findings):
            for start, problem in problems.items():
                outcomes += self._outcomes(who._replace(start=start), chosen, case, setting, problem)
        samples = case.test.states.shape[1]
        without: dict[Start, Tensor] = {
            start: rollout(case.flow, problem.starts, case.dt, samples) for start, problem in problems.items()
        }
        scores = {start: case.score(prediction) for start, prediction in without.items()}
        findings.numbers["filters"] = {}
        for outcome in outcomes:
            who = outcome.who
            findings.rows += rows(outcome, case, scores[who.start] if who.process == MODEL else None)
            several = findings.numbers["filters"].setdefault(who.estimator, {})
            entry = several.setdefault("floor" if who.floor else who.process, {})
            entry[who.start] = numbers(outcome, case) | moving_averages(outcome, case)
        findings.arrays, findings.figures = ukf_figures(case, setting, outcomes, without)
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
        """Return the filter as an online process, its process noise as it is configured.

        Args:
            flow: the process model.
            interval: sampling interval of the training data.
            space: what the numbers mean.
            case: gives the data that a process noise is fitted to; called only for that.
            novelty: distance (...) of states (..., D) from the training data, where it is known.
            known: covariance of the parameters, where it is known.

        Raises:
            UserError: the novelty is to count, and is not known; or nothing is known of the parameters.
        """
        estimator = UnscentedKalmanFilter(self.parameters, self.form, self.gate)
        noise = given_noise(self.process_noise, space, grown(novelty, self.novelty), flow, known)
        if noise is None:
            noise = self._found(case())
        about = {"space": space.name, "flow": weights_hash(flow), "novelty": self.novelty}
        return online_process(estimator, flow, interval, *noise, about)

    @torch.no_grad()
    def _found(self, case: Case) -> Noise:
        """Return the process noise that is fitted to validation data."""
        require_truth(self.process_noise, case.truth or self.beside)
        shortest = int(case.validation.present.sum(-1).min()) - 1
        setting = self._setting(near_system(case.truth, self.beside, case.space), shortest)
        (_, model), *_ = self._filters(case, setting, Findings())
        return model.process_noise, model.force_error

    def _outcomes(
        self, who: Who, chosen: Filter, case: Case, setting: Setting, problem: Problem
    ) -> list[Outcome]:
        """Return what becomes of a filter, and of its smoother if asked for, in one scenario."""
        with shown(chosen.flow, described(who, case.label), problem.measurements.shape[1]) as flow:
            chosen = chosen._replace(flow=flow)
            if not (self.smoother or self.least_squares):
                return [filtered(who, setting, problem, assimilate(chosen, setting, problem))]
            asked = {"iterated": self.smoother == "iterated", "batch": self.least_squares}
            result, behind = assimilate_all(chosen, setting, problem, **asked)
        outcomes = [filtered(who, setting, problem, result)]
        if self.smoother:
            outcomes.append(smoothed(who, setting, problem, result, behind.smoothed))
        if behind.iterated is not None:
            outcomes.append(iterated(who, setting, problem, result, behind.iterated))
        if behind.batch is not None:
            outcomes.append(fitted(who, setting, problem, behind.batch))
        return outcomes

    def _filters(self, case: Case, setting: Setting, findings: Findings) -> list[tuple[Who, Filter]]:
        """Return the filters of the table: the model's, tuned if asked for, and the floor."""
        r, size = setting.measurement_noise, case.test.states.shape[-1]
        nothing = torch.zeros(size, size, dtype=torch.float64)
        constants = r, self.parameters, self.form, self.gate
        plain = Filter(f"{case.label} + UKF", case.flow, nothing, *constants)

        def arcs(count: int) -> Problem:
            return self._arcs(case, setting, count, None, self.seed + 1)

        model, about = with_process_noise(self.process_noise, plain, case, setting, arcs, self.novelty)
        findings.numbers["process_noise"] = about
        filters = [(Who(MODEL, "true", "ukf"), model)]
        if self.tuning is not None:
            options = self.tuning
            parts = self._arcs(case, setting, options.trajectories, options.steps, self.seed + 3)
            tuned = tuned_once(model, setting, parts, options, case.folder / "ukf_tuned.json")
            findings.numbers["tuning"] = tuned._asdict()
            filters.append((Who(MODEL, "true", "ukf_tuned"), tuned.apply(model)))
        if case.truth is not None:
            exact = exact_flow(case.truth)
            floor = Filter("exact flow + UKF", exact, nothing, *constants)
            filters.append((Who("exact flow", "true", "ukf", floor=True), floor))
        if self.beside is not None:
            other = plain._replace(name=f"{self.beside.name} + UKF", flow=exact_flow(self.beside))
            option = without_parameters(self.process_noise)
            other, about = with_process_noise(option, other, case, setting, arcs)
            findings.numbers["process_noise_beside"] = about
            filters.append((Who(self.beside.name, "true", "ukf"), other))
        return filters

    def _arcs(self, case: Case, setting: Setting, count: int, steps: int | None, seed: int) -> Problem:
        """Return arcs of at most so many validation trajectories; no row of the results is of them."""
        count = min(count, len(case.validation.states))
        return perturbed_arcs(setting, case.validation.states, _interval(case), count, steps, seed)

    def _problems(self, case: Case, setting: Setting) -> dict[Start, Problem]:
        """Return the scenarios; both see the same measurements."""
        truth = case.test.states
        dt = _interval(case)
        measurements = simulated(setting, truth, dt, self.seed)
        return {start: Problem(truth, x, measurements, dt) for start, x in case.starts().items()}

    def _settings(self, setting: Setting) -> dict[str, Any]:
        """Return what was assumed, for metrics.json."""
        return {
            "updates": list(setting.updates),
            "measured": list(setting.measurement.names),
            "measurement_sd": setting.measurement_sd.tolist(),
            "start_sd": setting.start_sd.tolist(),
            "form": self.form.name,
            "parameters": self.parameters._asdict(),
            "seed": self.seed,
        }


def _interval(case: Case) -> float:
    """Return the one step of simulated trajectories."""
    assert isinstance(case.dt, float), "simulated trajectories have one step"
    return case.dt

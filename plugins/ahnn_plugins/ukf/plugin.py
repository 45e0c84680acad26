"""Evaluation plugin of the unscented Kalman filter: `plugins=ukf`."""

from __future__ import annotations

from typing import Annotated, Any, Literal, final

from ahnn.arguments import Count, Finite, Positive, Within, check_arguments, checked
from ahnn.errors import UserError
from ahnn.estimation.scenario import Setting
from ahnn.estimation.trial import Filter
from ahnn.evaluation.case import Case, Findings, Who
from ahnn.evaluation.estimators import Bias, EstimatorEvaluation
from ahnn.evaluation.estimators.noise_options import GivenNoise
from ahnn.evaluation.titles import MODEL
from ahnn.measurements import Measurement
from ahnn.systems import System
from ahnn_plugins.ukf.parameters import UnscentedParameters
from ahnn_plugins.ukf.regression import regression_weights
from ahnn_plugins.ukf.sigma_points import unscented_weights
from ahnn_plugins.ukf.square_root import SQUARE_ROOT
from ahnn_plugins.ukf.standard import STANDARD
from ahnn_plugins.ukf.tuning import Tuning, tuned_once
from ahnn_plugins.ukf.unscented_filter import UnscentedKalmanFilter


@final
@checked
class UKFEvaluation(EstimatorEvaluation):
    """Unscented Kalman filter with the model as process model, and with the exact dynamics.

    Args:
        cadence: see `EstimatorEvaluation`, also for all arguments not listed here.
        alpha, beta, kappa: parameters of the sigma points.
        form: form of the covariance.
        smoother: whether to add the rows of the smoother; `iterated` also adds the rows of the iterated
            smoother.
        tuning: options of `Tuning`, which adds the rows of a tuned filter; None for no tuning.
        name: name in tables and of the configuration node.
    """

    def __init__(
        self,
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
        name: Literal["ukf", "ckf"] = "ukf",
    ) -> None:
        self.parameters = UnscentedParameters(alpha, beta, kappa)
        chosen = {"square_root": SQUARE_ROOT, "standard": STANDARD}[form]
        super().__init__(
            UnscentedKalmanFilter(self.parameters, chosen, name=name),
            cadence=cadence,
            times=times,
            measurement=measurement,
            measurement_sd=measurement_sd,
            bias_sd=bias_sd,
            bias_memory=bias_memory,
            start_sd=start_sd,
            process_noise=process_noise,
            novelty=novelty,
            gate=gate,
            patience=patience,
            smoother=smoother,
            least_squares=least_squares,
            seed=seed,
            beside=beside,
        )
        self.tuning = None
        if tuning is not None:
            check_arguments("tuning", Tuning, tuning)
            self.tuning = Tuning(**tuning)

    def require_constants(self, setting: Setting, steps: int, size: int) -> None:
        """Check that sigma points exist, and that tuning uses at least one measurement."""
        if self.tuning is not None and (self.tuning.steps or steps) < setting.first:
            first = f"{setting.first}, the step of the first measurement"
            message = f"tuning.steps: expected at least {first}; received {self.tuning.steps}"
            raise UserError(message)
        weights = regression_weights if "iterated" in self.smoothers else unscented_weights
        weights(self.parameters, size)

    def tried(
        self, model: Filter, case: Case, setting: Setting, findings: Findings
    ) -> list[tuple[Who, Filter]]:
        """Return the tuned filter, if requested."""
        if (options := self.tuning) is None:
            return []
        parts = self.arcs(case, setting, options.trajectories, options.steps, self.seed + 3)
        tuned = tuned_once(model, setting, parts, options, case.folder / f"{self.estimator.name}_tuned.json")
        findings.numbers["tuning"] = tuned._asdict()
        return [(Who(MODEL, "true", f"{self.estimator.name}_tuned"), tuned.apply(model))]

    def settings(self, setting: Setting) -> dict[str, Any]:
        """Return the assumptions, for metrics.json."""
        own = {"form": self.estimator.about["form"], "parameters": self.parameters._asdict()}
        return super().settings(setting) | own

"""An evaluation plugin: the extended Kalman filter with what was learned as its process model."""

from typing import Literal, final

import torch
from torch import Tensor

from ahnn.arguments import Count, Positive, checked
from ahnn.errors import UserError
from ahnn.estimation import Setting, initial_belief, simulated
from ahnn.evaluation import Case, Findings, Row, Who
from ahnn.measurements import Measurement, reading
from ahnn.systems import System
from ahnn.types import Space
from duffing.estimator import ExtendedKalmanFilter


@final
@checked
class EKFEvaluation:
    """Rows `+ EKF` from every start; its arguments are the keys of `plugins.first_order` in YAML."""

    def __init__(
        self,
        *,
        measurement: Measurement | Literal["position", "state"],
        measurement_sd: Positive,
        process_sd: Positive,
        cadence: Count,
        seed: int,
    ) -> None:
        self.measurement, self.seed, self.cadence = measurement, seed, cadence
        self.measurement_sd, self.process_sd = measurement_sd, process_sd

    def check(self, truth: System | None, space: Space, steps: int) -> None:
        """Refuse data that it does not fit, before anything is trained on them."""
        if truth is None or steps < self.cadence:
            known = f"{space.name} with {steps} steps"
            message = (
                f"cadence: expected at most the steps of a known system; received {self.cadence}, {known}"
            )
            raise UserError(message)

    @torch.no_grad()
    def __call__(self, case: Case) -> Findings:
        """Filter the test trajectories."""
        assert case.truth is not None
        assert isinstance(case.dt, float)
        model = (
            reading(self.measurement, case.space) if isinstance(self.measurement, str) else self.measurement
        )
        sd = torch.full((len(model.names),), self.measurement_sd, dtype=torch.float64)
        updates = tuple(range(self.cadence, case.test.states.shape[1], self.cadence))
        setting = Setting(model, sd, case.truth.deviations(), updates)
        rows = simulated(setting, case.test.states, case.dt, self.seed)
        findings = Findings(numbers={"cadence": self.cadence, "measured": list(model.names)})
        for start, x in case.starts().items():
            estimates, nis = self.filtered(case, setting, x, rows)
            extra = {"mean_nis": float(nis.nanmean())}
            findings.rows.append(Row(Who("model", start, "ekf"), case.score(estimates), extra=extra))
            findings.arrays[f"{start}_start"] = estimates
        return findings

    def filtered(self, case: Case, setting: Setting, x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Return the means (B, T, D) and the NIS (B, T - 1) of the filter that starts at x, (B, D)."""
        ekf = ExtendedKalmanFilter()
        state = ekf.start(initial_belief(x, setting.start_covariance))
        q = self.process_sd**2 * setting.start_covariance
        means, nis = [x], []
        for row in rows.unbind(1):
            state = ekf.predict(state, case.flow, float(case.dt), q)
            state, told = ekf.update(state, row, setting.measurement, setting.measurement_noise)
            means.append(state.belief.mean)
            nis.append(told.nis)
        return torch.stack(means, dim=1), torch.stack(nis, dim=1)

"""Construction of the evaluation case of learned dynamics and their data."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ahnn.data import SplitData
from ahnn.data.recorded_sensor import Recorded
from ahnn.data.segments import whole
from ahnn.dynamics import Dynamics, HasEnergy
from ahnn.evaluation.case import Case, perturbations
from ahnn.evaluation.goodness_of_fit import cleaned, fit_to, outlier_fraction
from ahnn.evaluation.shortfall import shortfall
from ahnn.measurements import Instrument, NoiseEstimate, Segment
from ahnn.measurements.smoothing import located_at
from ahnn.shooting.robust import RobustName
from ahnn.statistics import sampling_interval
from ahnn.stored import read
from ahnn.types import Trajectories
from ahnn.uncertainty import Domain, Uncertainty


def make_case(
    dynamics: Dynamics,
    data: SplitData,
    *,
    label: str,
    seed: int,
    folder: Path,
    uncertainty: Uncertainty | None = None,
    domain: Domain | None = None,
    robust: RobustName = "none",
    about: Mapping[str, Any] | None = None,
    remark: str = "",
    caveat: str = "",
) -> Case:
    """Build the case of learned dynamics on the test trajectories of their data.

    Args:
        dynamics: learned dynamics, in float64 on the CPU.
        data: data with training, validation and test splits.
        label: name in tables.
        seed: seed for the initial errors.
        folder: output folder.
        uncertainty: covariance of the parameters, if available.
        domain: representative training states, if available.
        robust: robust loss of the training.
        about: metadata of the weights, with the noise that the training estimated.
        remark: remark on the data, for the table.
        caveat: reason why the training cannot have produced a good model.
    """
    source, truth, about = data.source, data.source.truth, about or {}
    estimate = estimated_noise(data, about)
    measured = measured_test(data, estimate)
    recorded = measured if isinstance(data.sensor, Recorded) else None
    fitted, test, outliers = tests_of(dynamics, data, recorded, robust)
    return Case(
        label=label,
        assumes=dynamics.assumes,
        space=source.space,
        truth=truth,
        flow=dynamics,
        energy=dynamics.energy if isinstance(dynamics, HasEnergy) else None,
        integrator=getattr(dynamics, "integrator", None),
        dt=sampling_interval(test),
        test=test,
        validation=data["val"],
        train=data["train"],
        perturbation=None if truth is None else perturbations(truth, len(test.states), seed),
        folder=folder,
        measured=measured,
        robust=robust,
        learned_from=None if data.sensor is None else learned_from(data, estimate),
        uncertainty=uncertainty,
        novelty=None if domain is None else partial(domain.novelty, dynamics),
        fitted=fitted,
        outliers=outliers,
        noise=estimate,
        remark=remark,
        caveat=caveat,
        shortfall=shortfall(about),
    )


def estimated_noise(data: SplitData, about: Mapping[str, Any]) -> NoiseEstimate | None:
    """Return the noise of the sensor from the metadata of weights; None if no training estimated it."""
    noise = None if data.sensor is None else about.get("noise")
    return None if noise is None else read("noise", NoiseEstimate, noise)


def tests_of(
    dynamics: Dynamics, data: SplitData, recorded: Segment | None, robust: RobustName
) -> tuple[Tensor | None, Trajectories, float]:
    """Return fitted initial states (B, D), test data without outliers, and the fraction of outliers.

    Without recorded measurements there are no fitted states, and the test data are those of the split.
    """
    if recorded is None:
        return None, data["test"], 0.0
    found, steps = fit_to(dynamics, recorded, robust)
    kept = cleaned(recorded, found, steps, robust)
    return found.starts, as_test(kept), outlier_fraction(recorded, kept)


def learned_from(data: SplitData, noise: NoiseEstimate | None) -> Segment:
    """Return the measurements of the training trajectories."""
    measured = data.measured("train")
    return Segment(*measured, instrument_of(data, noise))


def as_test(measured: Segment) -> Trajectories:
    """Return the measured positions or states as test trajectories, NaN elsewhere."""
    shown = located_at(measured.instrument, measured.values, measured.times)
    missing = 2 * measured.instrument.dof - shown.shape[-1]
    return Trajectories(pad(shown, (0, missing), value=torch.nan), measured.times)


def measured_test(data: SplitData, noise: NoiseEstimate | None) -> Segment | None:
    """Return the measurements of the test trajectories; None if states are known."""
    if data.sensor is None:
        return None
    return whole(data.measured("test"), instrument_of(data, noise))


def instrument_of(data: SplitData, noise: NoiseEstimate | None) -> Instrument:
    """Return the instrument, with any noise estimated in training; raises the same errors as `applied`."""
    assert data.sensor is not None
    found = data.instrument()
    return found if noise is None else noise.applied(found, data.sensor.unknown)

"""Tuning of a filter as in the paper: search for the constants with the smallest error on validation arcs.

A tree-structured Parzen estimator searches alpha, beta, kappa and one factor each for Q and R. Trials are
requested in batches, with a constant liar for pending results, and filtered as one batch.
"""

from __future__ import annotations

import hashlib
import json
import warnings
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, cast

import torch
from torch import Tensor

from ahnn.arguments import Count, Interval, Range, Seed, Within, check_arguments, checked
from ahnn.contents import read_whole
from ahnn.dynamics.flow_at_time import at
from ahnn.errors import UserError
from ahnn.estimation.belief import Status
from ahnn.estimation.scenario import Problem, Setting
from ahnn.estimation.trial import Filter, assimilate, shown
from ahnn.files import write_atomically
from ahnn.manifest import is_own
from ahnn.metrics import errors, rmse_norm
from ahnn_plugins.ukf.parameters import UnscentedParameters
from ahnn_plugins.ukf.unscented_filter import UnscentedKalmanFilter

if TYPE_CHECKING:
    from optuna import Study
    from optuna.distributions import BaseDistribution

LOGARITHMIC = ("alpha", "scale_q", "scale_r")

Factors = Annotated[tuple[float, float] | list[float], Interval(Within(above=0))]
LOST = 1e12
"""Objective of a trial with a failed member: finite, so that the sampler can use it."""


class Ranges(NamedTuple):
    """Search ranges [low, high]; the last two are factors of Q and R."""

    alpha: Factors | None = None
    beta: Range | None = None
    kappa: Range | None = None
    scale_q: Factors | None = None
    scale_r: Factors | None = None


@checked
@dataclass(frozen=True)
class Tuning:
    """Extent of the search.

    Attributes:
        ranges: [low, high] of each tuned constant; all other constants are fixed.
        trials: number of filters tried.
        trajectories: number of validation trajectories, with one arc each.
        steps: number of steps per arc; None for full trajectories.
        batch: number of trials filtered together.
        seed: seed of the sampler.
    """

    ranges: dict[str, list[float]]
    trials: Count
    trajectories: Count
    steps: Count | None
    batch: Count
    seed: Seed

    def __post_init__(self) -> None:
        """Raise UserError for invalid ranges."""
        check_arguments("ranges", Ranges, self.ranges)

    def space(self) -> dict[str, BaseDistribution]:
        """Return the search space."""
        from optuna.distributions import FloatDistribution

        return {
            name: FloatDistribution(*interval, log=name in LOGARITHMIC)
            for name, interval in self.ranges.items()
        }


class Tuned(NamedTuple):
    """Result of a search: the best values, their objective, and the objective of the initial values."""

    values: dict[str, float]
    objective: float
    untuned: float

    def apply(self, chosen: Filter) -> Filter:
        """Return a filter with the tuned constants."""
        v = own_values(chosen) | self.values
        parameters = UnscentedParameters(v["alpha"], v["beta"], v["kappa"])
        return with_points(chosen, parameters).scaled(v["scale_q"], v["scale_r"])


def tune(chosen: Filter, setting: Setting, problem: Problem, options: Tuning) -> Tuned:
    """Search for the best constants of a filter, starting from its own.

    Args:
        chosen: filter with its untuned constants.
        setting: measurement settings and P0.
        problem: V validation arcs.
        options: extent of the search.
    """
    study, space = _study(options.seed), options.space()
    study.enqueue_trial(_begin(chosen, options))
    sizes = [min(options.batch, options.trials - i) for i in range(0, options.trials, options.batch)]
    calls = len(sizes) * (problem.truth.shape[1] - 1)
    with shown(chosen.flow, f"tuning {chosen.name}: {options.trials} trials", calls) as flow:
        for size in sizes:
            trials = [study.ask(space) for _ in range(size)]
            values = objectives(chosen._replace(flow=flow), setting, problem, [t.params for t in trials])
            for trial, value in zip(trials, values, strict=True):
                study.tell(trial, value)
    best = study.best_trial
    return Tuned(dict(best.params), float(study.best_value), float(study.trials[0].values[0]))


def points_of(chosen: Filter) -> UnscentedKalmanFilter:
    """Return the estimator of a filter, whose sigma points are tuned."""
    return cast(UnscentedKalmanFilter, chosen.estimator)


def with_points(chosen: Filter, parameters: UnscentedParameters) -> Filter:
    """Return a filter with other sigma points."""
    return chosen._replace(estimator=replace(points_of(chosen), parameters=parameters))


def own_values(chosen: Filter) -> dict[str, float]:
    """Return the constants of a filter by search name; the factors of Q and R are 1."""
    parameters = {name: float(value) for name, value in points_of(chosen).parameters._asdict().items()}
    return {**parameters, "scale_q": 1.0, "scale_r": 1.0}


def _begin(chosen: Filter, options: Tuning) -> dict[str, float]:
    """Return the first trial, with the filter's own constants.

    Raises:
        UserError: a constant outside its range.
    """
    own = own_values(chosen)
    for name, (low, high) in options.ranges.items():
        if not low <= own[name] <= high:
            message = (
                f"tuning.ranges.{name}: expected a range that contains the untuned {own[name]:g}, at which "
                f"the search starts; received {[low, high]}"
            )
            raise UserError(message)
    return {name: own[name] for name in options.ranges}


def objectives(
    chosen: Filter, setting: Setting, problem: Problem, trials: list[dict[str, float]]
) -> list[float]:
    """Return the objectives of trials, filtered in one batch.

    The objective is the RMSE of the position plus the RMSE of the velocity, each component in units of its
    initial standard deviation, after the first update, since earlier errors do not depend on the filter.
    """
    count, (batch, _, size) = len(trials), problem.truth.shape
    trials = [own_values(chosen) | trial for trial in trials]

    def column(name: str) -> Tensor:
        return torch.tensor([t[name] for t in trials], dtype=torch.float64).repeat_interleave(batch)

    parameters = UnscentedParameters(column("alpha"), column("beta"), column("kappa"))
    candidate = with_points(chosen, parameters).scaled(column("scale_q"), column("scale_r"))
    result = assimilate(candidate, setting, problem.repeated(count))
    first = setting.first - 1
    truth = problem.truth[:, 1 + first :].repeat(count, 1, 1)
    error = errors(result.means[:, first:], truth) / setting.start_sd
    lost = (result.status != Status.OK).reshape(count, batch).any(-1)
    values = []
    for i, part in enumerate(error.reshape(count, batch, -1, size)):
        position, velocity = part.chunk(2, dim=-1)
        value = float(rmse_norm(position) + rmse_norm(velocity))
        values.append(LOST if bool(lost[i]) or not value < LOST else value)
    return values


def tuned_once(chosen: Filter, setting: Setting, problem: Problem, options: Tuning, path: Path) -> Tuned:
    """Return the tuned constants stored for an identical search, or search and store them."""
    recipe = _recipe(chosen, setting, problem, options)
    stored = _stored(path)
    if stored.get("recipe") == recipe:
        return Tuned(stored["values"], stored["objective"], stored["untuned"])
    tuned = tune(chosen, setting, problem, options)
    if path.exists() and not is_own(path):  # changed by a user
        return tuned
    write_atomically(path, json.dumps({**tuned._asdict(), "recipe": recipe}, indent=2).encode())
    return tuned


def _stored(path: Path) -> dict[str, Any]:
    """Read a file of tuned values; empty if it is missing or damaged."""
    try:
        stored = json.loads(read_whole(path))
    except (OSError, ValueError, RecursionError):
        return {}
    return stored if isinstance(stored, dict) else {}


def _recipe(chosen: Filter, setting: Setting, problem: Problem, options: Tuning) -> dict[str, Any]:
    """Return the definition of a search as plain values; images of states identify the flow."""
    with torch.no_grad():
        image = at(problem.driven(chosen.flow), 0.0)(problem.truth[:, 0], problem.dt)
    tensors = {
        "image": image,
        "process_noise": chosen.process_noise,
        "measurement_noise": chosen.measurement_noise,
        "start_sd": setting.start_sd,
        "parameters": torch.tensor([float(p) for p in points_of(chosen).parameters]),
    }
    if chosen.force_error is not None:
        tensors["force_error"] = chosen.force_error.numbers(problem.truth)
    arcs = b"".join(part.numpy().tobytes() for part in (problem.starts, problem.measurements))
    return {
        "tuning": asdict(options),
        "arcs": hashlib.sha256(arcs).hexdigest(),
        "form": points_of(chosen).form.name,
        "gate": None if (gate := points_of(chosen).gate) is None else list(gate),
        **{name: [f"{v:.5e}" for v in tensor.flatten().tolist()] for name, tensor in tensors.items()},
    }


def _study(seed: int) -> Study:
    """Return an empty study in memory."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    with warnings.catch_warnings():
        # The constant liar was experimental before Optuna 5.
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        sampler = optuna.samplers.TPESampler(seed=seed, constant_liar=True)
    return optuna.create_study(sampler=sampler)

"""The paper's way to a good filter: search its constants for the smallest error on validation arcs.

Tree-structured Parzen estimator over alpha, beta, kappa and one factor each for Q and R. A batch of trials is
asked for at once, with a constant liar in place of the results still missing, and filtered as one batch.
"""

from __future__ import annotations

import json
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor

from ahnn.data.store import write_atomically
from ahnn.errors import UserError
from ahnn.metrics import errors, rmse_norm
from ahnn_plugins.ukf.scenario import Filter, Problem, Setting, assimilate, shown
from ahnn_plugins.ukf.types import Status, UnscentedParameters

if TYPE_CHECKING:
    from optuna import Study

RANGES = {
    "alpha": (1e-3, 1.0),
    "beta": (0.0, 4.0),
    "kappa": (0.0, 3.0),
    "scale_q": (1e-2, 1e2),
    "scale_r": (1e-1, 1e1),
}
"""Search space; alpha and the factors of Q and R on a logarithmic scale. The paper gives none."""

LOGARITHMIC = ("alpha", "scale_q", "scale_r")

LOST = 1e12
"""Objective of a trial that loses a member: finite, so that the sampler learns from it."""


@dataclass(frozen=True)
class Tuning:
    """How much is searched.

    Attributes:
        trials: filters that are tried.
        trajectories: validation trajectories, one arc of each.
        steps: length of an arc; None takes whole trajectories.
        batch: trials that are filtered together.
        seed: of the sampler.
    """

    trials: int
    trajectories: int
    steps: int | None
    batch: int
    seed: int

    def __post_init__(self) -> None:
        """Refuse counts below one."""
        for name, value in asdict(self).items():
            if name != "seed" and value is not None and value < 1:
                message = f"plugins.ukf.tuning.{name}: expected at least 1; received {value}"
                raise UserError(message)


class Tuned(NamedTuple):
    """Result of a search: the best values, their objective, and that of the values it began with."""

    values: dict[str, float]
    objective: float
    untuned: float

    def apply(self, chosen: Filter) -> Filter:
        """Return a filter with the tuned constants."""
        v = self.values
        return chosen._replace(
            parameters=UnscentedParameters(v["alpha"], v["beta"], v["kappa"]),
            process_noise=v["scale_q"] * chosen.process_noise,
            measurement_noise=v["scale_r"] * chosen.measurement_noise,
        )


def tune(chosen: Filter, setting: Setting, problem: Problem, options: Tuning) -> Tuned:
    """Search the constants of a filter, beginning with its own.

    Args:
        chosen: the filter with its untuned constants.
        setting: measurements and P0.
        problem: V validation arcs.
        options: how much is searched.
    """
    study = _study(options.seed)
    parameters = chosen.parameters._asdict()
    start = {name: float(parameters.get(name, 1.0)) for name in RANGES}  # factors of Q and R begin at 1
    study.enqueue_trial(start)
    sizes = [min(options.batch, options.trials - i) for i in range(0, options.trials, options.batch)]
    calls = len(sizes) * (problem.truth.shape[1] - 1)
    with shown(chosen.flow, f"tuning {chosen.name}: {options.trials} trials", calls) as flow:
        for size in sizes:
            trials = [study.ask(_space()) for _ in range(size)]
            values = objectives(chosen._replace(flow=flow), setting, problem, [t.params for t in trials])
            for trial, value in zip(trials, values, strict=True):
                study.tell(trial, value)
    best = study.best_trial
    return Tuned(dict(best.params), float(study.best_value), float(study.trials[0].values[0]))


def objectives(
    chosen: Filter, setting: Setting, problem: Problem, trials: list[dict[str, float]]
) -> list[float]:
    """Return the objective of each trial, all of them filtered in one batch.

    The objective is the RMSE of the position plus that of the velocity, each component in units of its
    initial standard deviation, from the first update on: what is before it no filter can change.
    """
    count, (batch, _, size) = len(trials), problem.truth.shape

    def column(name: str) -> Tensor:
        return torch.tensor([t[name] for t in trials], dtype=torch.float64).repeat_interleave(batch)

    candidate = chosen._replace(
        parameters=UnscentedParameters(column("alpha"), column("beta"), column("kappa")),
        process_noise=column("scale_q")[:, None, None] * chosen.process_noise,
        measurement_noise=column("scale_r")[:, None, None] * chosen.measurement_noise,
    )
    result = assimilate(candidate, setting, problem.repeated(count))
    first = setting.cadence - 1
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
    """Return the tuned constants that a file holds for this very search, or search and write it."""
    recipe = _recipe(chosen, setting, problem, options)
    if path.is_file():
        stored = json.loads(path.read_text())
        if stored["recipe"] == recipe:
            return Tuned(stored["values"], stored["objective"], stored["untuned"])
    tuned = tune(chosen, setting, problem, options)
    write_atomically(path, json.dumps({**tuned._asdict(), "recipe": recipe}, indent=2).encode())
    return tuned


def _recipe(chosen: Filter, setting: Setting, problem: Problem, options: Tuning) -> dict[str, Any]:
    """Return what determines a search, as plain values; the flow is known by what it does to a state."""
    with torch.no_grad():
        image = chosen.flow(problem.truth[:1, 0], problem.dt)
    tensors = {
        "image": image,
        "process_noise": chosen.process_noise,
        "measurement_noise": chosen.measurement_noise,
        "parameters": torch.tensor([float(p) for p in chosen.parameters]),
    }
    return {
        "tuning": asdict(options),
        "measurement": type(setting.measurement).__name__,
        "cadence": setting.cadence,
        "form": setting.form.name,
        "gate": None if setting.gate is None else list(setting.gate),
        **{name: [f"{v:.5e}" for v in tensor.flatten().tolist()] for name, tensor in tensors.items()},
    }


def _study(seed: int) -> Study:
    """Return an empty study in memory."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    with warnings.catch_warnings():
        # The constant liar was marked experimental before Optuna 5.
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        sampler = optuna.samplers.TPESampler(seed=seed, constant_liar=True)
    return optuna.create_study(sampler=sampler)


def _space() -> dict[str, Any]:
    from optuna.distributions import FloatDistribution

    return {
        name: FloatDistribution(low, high, log=name in LOGARITHMIC) for name, (low, high) in RANGES.items()
    }

"""Comparison of estimators on the same scenarios, with the true flow.

    python benchmarks/bench_estimators.py [--seeds 5] [--scenarios A,B] [--estimators "a;b"]

For each scenario a table: the error divided by the floor's error (`estimator_scenarios`), NEES per component
of the state (1 if consistent), log-likelihood of a measured number, lost members, and the CPU time of a step
of a member. Errors are root mean squares over the members that are not lost and times after the first
measurement. Medians over the seeds, and their range.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from statistics import median
from typing import Any, NamedTuple

import torch
from estimator_scenarios import SCENARIOS, Drawn, Scenario, along_truth, drawn, run
from timing import markdown, settle
from torch import Tensor

from ahnn.estimation import Gate, nees
from ahnn.estimation.estimator import Estimator
from ahnn_plugins.ekf import ExtendedKalmanFilter
from ahnn_plugins.enkf import EnsembleKalmanFilter
from ahnn_plugins.particle import ParticleFilter
from ahnn_plugins.ukf import GaussHermiteFilter, UnscentedKalmanFilter, UnscentedParameters

GATE = Gate(0.9999, 10)
"""Where there are outliers."""
FLOOR = ParticleFilter(particles=5_000, stages=1, bandwidth=0.0)
ESTIMATORS: dict[str, Estimator[Any]] = {
    "ekf": ExtendedKalmanFilter(),
    "ekf, 5 iterations": ExtendedKalmanFilter(iterations=5),
    "ukf": UnscentedKalmanFilter(),
    "ckf": UnscentedKalmanFilter(UnscentedParameters(1.0, 0.0, 0.0), name="ckf"),
    "ghkf": GaussHermiteFilter(),
    "enkf, square root": EnsembleKalmanFilter(),
    "enkf, stochastic": EnsembleKalmanFilter(form="stochastic"),
    "particle": ParticleFilter(),
    "particle, ukf proposal": ParticleFilter(particles=300, proposal="ukf"),
    "particle, bootstrap": ParticleFilter(stages=1, bandwidth=0.0),
}


class Score(NamedTuple):
    """What one estimator made of one draw.

    Attributes:
        ratio: error divided by the floor's error.
        nees: for each component of the state, mean over members that were kept.
        likelihood: log density of a number that was taken.
        lost: fraction of the members.
        micros: CPU time of a step of a member.
    """

    ratio: float
    nees: float
    likelihood: float
    lost: float
    micros: float


def rms(error: Tensor) -> float:
    """Return the root mean square length of errors (B, T, n), members that were lost left out."""
    return float(error.square().sum(-1).nanmean().sqrt())


def floor(scenario: Scenario, case: Drawn) -> float:
    """Return the error of the floor."""
    if scenario.linear:
        means = along_truth(scenario, UnscentedKalmanFilter(), case)
    else:
        means = run(scenario, FLOOR, case).means
    return rms(late(scenario, means - case.truth[:, 1:])[..., scenario.scored])


def late(scenario: Scenario, values: Tensor) -> Tensor:
    """Return values (B, T, ...), starting at the first measurement."""
    return values[:, scenario.updates[0] - 1 :]


def scored(scenario: Scenario, estimator: Estimator[Any], case: Drawn, least: float) -> Score:
    """Return the score of an estimator on a draw whose floor is known."""
    begin = time.process_time()
    result = run(scenario, estimator.gated(GATE) if scenario.outliers else estimator, case)
    seconds, (members, steps) = time.process_time() - begin, case.rows.shape[:2]
    error = late(scenario, result.means - case.truth[:, 1:])
    values = nees(error, late(scenario, result.chols)).nanmean() / error.shape[-1]
    numbers = (result.measured * ~result.rejected).sum()
    kept = result.status == 0
    return Score(
        rms(error[kept][..., scenario.scored]) / least,
        float(values),
        float(result.log_likelihood.sum() / numbers),
        float((~kept).double().mean()),
        1e6 * seconds / (members * steps),
    )


def scores(scenario: Scenario, seeds: int, names: list[str]) -> Iterator[dict[str, Score]]:
    """Yield the scores of the estimators for each seed, and what the floor is."""
    for seed in range(seeds):
        case = drawn(scenario, seed)
        least = floor(scenario, case)
        yield {
            "floor": Score(least, 0.0, 0.0, 0.0, 0.0),
            **{name: scored(scenario, ESTIMATORS[name], case, least) for name in names},
        }
        print(f"{scenario.name}: seed {seed}", file=sys.stderr, flush=True)


def shown(values: list[float]) -> str:
    """Return the median and the range of numbers."""
    digits = (f"{value:.3g}" for value in (median(values), min(values), max(values)))
    return "{} ({} to {})".format(*digits)


def table(found: list[dict[str, Score]], names: list[str]) -> str:
    """Return the table of a scenario."""
    heads = ["estimator", "error / floor", "NEES / D", "log-likelihood", "lost [%]", "time [us]"]
    rows = []
    for name in names:
        columns = zip(*(one[name] for one in found), strict=True)
        ratios, nees_, likelihoods, lost, micros = (list(column) for column in columns)
        percent = f"{100 * sum(lost) / len(lost):.0f}"
        cells = [shown(part) for part in (ratios, nees_, likelihoods)]
        rows.append([name, *cells, percent, f"{median(micros):.3g}"])
    return markdown(heads, rows)


def main() -> None:
    """Print the tables."""
    every = [make.__name__ for make in SCENARIOS]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--scenarios", default=",".join(every), help=", ".join(every))
    parser.add_argument("--estimators", default=None, help="; ".join(ESTIMATORS) + "; separated by ;")
    given = parser.parse_args()
    names = [*ESTIMATORS] if given.estimators is None else given.estimators.split(";")
    settle()
    torch.set_grad_enabled(False)
    for make in SCENARIOS:
        if make.__name__ not in given.scenarios.split(","):
            continue
        scenario = make()
        found = list(scores(scenario, given.seeds, names))
        least = [one["floor"].ratio for one in found]
        print(f"**{scenario.name}**, floor {shown(least)} {scenario.unit}\n")
        print(table(found, names), flush=True)


if __name__ == "__main__":
    main()

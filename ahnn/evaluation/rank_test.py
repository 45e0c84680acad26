"""Simulation-based calibration: over draws of truth and data, ranks in calibrated bands are uniform.

The rank of a true number among infinitely many draws of a band is Phi(error / sd) (Cook, Gelman & Rubin 2006,
J. Comput. Graph. Stat. 15, 675-692). Ranks of one training run are dependent: a test uses one rank of each
run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from ahnn.evaluation import style
from ahnn.evaluation.bands import NORMAL
from ahnn.evaluation.independent_directions import DirectionTest, together

TIMES = ("a quarter", "half", "the end")
REFUSED = 0.05
"""Probability of rejecting calibrated bands, over all tests together."""
DRAWS = 20
"""With fewer draws, ranks that pass the test mean little."""
Score = Mapping[str, Mapping[str, Any]]
"""Numbers `uncertainty` and `forecast` of metrics.json."""


def ranks(scores: Sequence[Score]) -> dict[str, list[float]]:
    """Return the ranks in (0, 1) of each quantity, one for each draw, sorted."""
    found: dict[str, list[float]] = {}
    for one in scores:
        errors = {
            f"state at {when}": row for when, row in zip(TIMES, one["uncertainty"]["single"], strict=True)
        }
        for name, row in {**errors, "forecast": one["forecast"]["single"] or ()}.items():
            for i, error in enumerate(row):
                if math.isfinite(error):
                    found.setdefault(f"{name}, {i + 1}", []).append(0.5 + 0.5 * math.erf(error / 2**0.5))
    return {name: sorted(values) for name, values in found.items()}


def uniformity(values: Sequence[float]) -> float:
    """Return the p-value of sorted ranks by the Kolmogorov-Smirnov test of uniformity."""
    from scipy.stats import kstest

    return float(kstest(values, "uniform").pvalue)


def rank_table(scores: Sequence[Score]) -> str:
    """Return a line for each quantity, and the conclusion from all draws."""
    lines = [f"  {'ranks of one trajectory':<26}{'draws':>7}{'mean':>8}{'uniform, p':>12}"]
    every = {name: (uniformity(values), values) for name, values in ranks(scores).items()}
    for name, (p, values) in every.items():
        lines.append(f"  {name:<26}{len(values):>7}{sum(values) / len(values):>8.2f}{p:>12.2g}")
    least = min(p for p, _ in every.values())
    enough = "uniform" if len(scores) >= DRAWS else "too few draws to tell"
    verdict = enough if least * len(every) >= REFUSED else "not uniform"
    lines.append(f"ranks: {verdict}, least p {least:.2g} of {len(every)} tests")
    for name, part, key in (("states", "uncertainty", "coverage"), ("forecasts", "forecast", "states")):
        means = [sum(one[part][key][k] for one in scores) / len(scores) for k in range(len(NORMAL))]
        shares = ", ".join(f"{100 * mean:.1f}" for mean in means)
        lines.append(
            f"{name}, all trajectories: {shares} % within 1, 2, 3 sigma, mean of {len(scores)} draws"
        )
    tests = [one["uncertainty"]["test"] for one in scores]
    every_draw = together([DirectionTest(test["directions"], test["scatter"]) for test in tests])
    return "\n".join([*lines, f"bands of states, all draws: {every_draw.sentence()}"])


def rank_figure(scores: Sequence[Score]) -> Figure:
    """Draw the fraction of ranks below each value, minus that value, and the 95 % band of uniform ranks."""
    figure = style.canvas(7, 4)
    axes = figure.subplots()
    every = ranks(scores)
    for name, values in every.items():
        steps = [(k + 1) / len(values) - value for k, value in enumerate(values)]
        axes.step([0, *values, 1], [0, *steps, 0], where="post", label=name, lw=1)
    edge = 1.358 / len(scores) ** 0.5  # of Kolmogorov's distribution, 95 %
    axes.axhspan(-edge, edge, color=style.BAND, alpha=0.3, lw=0, label="uniform, 95 %")
    axes.set_xlabel("rank of the truth in its band")
    axes.set_ylabel("fraction of draws below, less rank")
    style.legend_below(figure, axes)
    return figure

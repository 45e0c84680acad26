"""Simulation-based calibration: over draws of truth and data, ranks in calibrated bands are uniform.

The rank of a true number among infinitely many draws of a band is Phi(error / sd) (Cook, Gelman & Rubin 2006,
J. Comput. Graph. Stat. 15, 675-692). Ranks from one training run are dependent: a test uses one rank from
each run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from ahnn.evaluation import style
from ahnn.evaluation.independent_directions import DirectionTest, together
from ahnn.numbers import in_percent
from ahnn.uncertainty.posterior import is_unfinished

TIMES = ("a quarter", "half", "the end")
PARTS = ("a fifth", "two fifths", "the end")
REFUSED = 0.05
"""Probability of rejecting calibrated bands, over all tests together."""
DRAWS = 20
"""With fewer draws, ranks that pass the test mean little."""
Score = Mapping[str, Mapping[str, Any]]
"""Entries `uncertainty` and `forecast` of metrics.json."""


def ranks(scores: Sequence[Score]) -> dict[str, list[float]]:
    """Return the ranks in (0, 1) of each quantity, one for each draw, sorted."""
    found: dict[str, list[float]] = {}
    for one in scores:
        rows = dict(zip((f"state at {when}" for when in TIMES), one["uncertainty"]["single"], strict=True))
        rows |= zip((f"forecast at {when}" for when in PARTS), one["forecast"]["single"] or (), strict=False)
        for name, row in rows.items():
            for i, error in enumerate(row):
                if math.isfinite(error):
                    found.setdefault(f"{name}, {i + 1}", []).append(0.5 + 0.5 * math.erf(error / 2**0.5))
    return {name: sorted(values) for name, values in found.items()}


def uniformity(values: Sequence[float]) -> float:
    """Return the p-value of sorted ranks by the Kolmogorov-Smirnov test of uniformity."""
    from scipy.stats import kstest

    return float(kstest(values, "uniform").pvalue)


def rank_table(scores: Sequence[Score]) -> str:
    """Return a table with a line for each quantity, and the conclusion from all draws."""
    lines = [f"  {'ranks of one trajectory':<26}{'draws':>7}{'mean':>8}{'uniform, p':>12}"]
    every = {name: (uniformity(values), values) for name, values in ranks(scores).items()}
    for name, (p, values) in every.items():
        lines.append(f"  {name:<26}{len(values):>7}{sum(values) / len(values):>8.2f}{p:>12.2g}")
    least = min(p for p, _ in every.values())
    enough = "uniform" if len(scores) >= DRAWS else "too few draws to tell"
    verdict = enough if least * len(every) >= REFUSED else "not uniform"
    lines.append(f"ranks: {verdict}, smallest p {least:.2g} in {len(every)} tests")
    lines += band_lines(scores)
    ended = [one for one in scores if not is_unfinished(one["uncertainty"])]
    if 0 < len(ended) < len(scores):
        lines.append(
            f"{len(scores) - len(ended)} of {len(scores)} training runs warn that they ended before their "
            "optimum; without them:"
        )
        lines += band_lines(ended)
    return "\n".join(lines)


def band_lines(scores: Sequence[Score]) -> list[str]:
    """Return lines on the coverage and the width of the bands of some draws."""
    draws = f"{len(scores)} draws"
    lines = [f"within 1, 2 and 3 sigma, all trajectories, mean over {draws}:"]
    lines += [f"  {name:<26}{share_line(rows)}" for name, rows in coverages(scores).items()]
    lines += partial_lines(scores)
    tests = [one["uncertainty"]["test"] for one in scores]
    every_draw = together([DirectionTest(test["directions"], test["scatter"]) for test in tests])
    return [*lines, f"bands of states, {draws}: {every_draw.sentence()}"]


def coverages(scores: Sequence[Score]) -> dict[str, list[Sequence[float]]]:
    """Return the fractions of states and forecasts within 1, 2 and 3 sigma, for each draw."""
    found = {
        "states": [one["uncertainty"]["coverage"] for one in scores],
        "forecasts": [one["forecast"]["states"] for one in scores],
    }
    for k, when in enumerate(PARTS):
        found[f"forecasts at {when}"] = [one["forecast"]["parts"][k] for one in scores]
    return found


def partial_lines(scores: Sequence[Score]) -> list[str]:
    """Return lines on the coverage within the linear range, and with sampled paths beyond it.

    There are none if all forecasts are within the linear range.
    """
    if not any(one["forecast"].get("nonlinear") for one in scores):
        return []
    fraction = 1 - sum(one["forecast"].get("nonlinear", 0.0) for one in scores) / len(scores)
    titles = {
        "linear": f"where errors propagate linearly ({in_percent(fraction)} of the forecast states):",
        "sampled": "with sampled paths where they do not:",
    }
    lines = []
    for key, title in titles.items():
        if found := [one["forecast"][key] for one in scores if one["forecast"].get(key)]:
            lines += [title, *part_lines(found)]
    return lines


def part_lines(scores: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return lines on partial coverages of forecasts, one for all times and one for each part."""
    rows = {"forecasts": [one["states"] for one in scores]}
    rows |= {f"forecasts at {when}": [one["parts"][k] for one in scores] for k, when in enumerate(PARTS)}
    lines = []
    for name, fractions in rows.items():
        found = [fraction for fraction in fractions if fraction is not None]
        line = f"{share_line(found)}, {len(found)} draws" if found else "none"
        lines.append(f"  {name:<26}{line}")
    return lines


def share_line(rows: Sequence[Sequence[float]]) -> str:
    """Format the means of fractions (N, 3), and the standard error of the mean within 2 sigma."""
    means = [sum(column) / len(rows) for column in zip(*rows, strict=True)]
    squares = sum((row[1] - means[1]) ** 2 for row in rows) / max(len(rows) - 1, 1)
    fractions = ", ".join(f"{100 * mean:.1f}" for mean in means)
    return f"{fractions} %, standard error {100 * (squares / len(rows)) ** 0.5:.1f} % within 2 sigma"


def rank_figure(scores: Sequence[Score]) -> Figure:
    """Draw the fraction of ranks below each value, minus that value, and the 95 % band of uniform ranks."""
    figure = style.canvas(7, 4)
    axes = figure.subplots()
    colours: dict[str, str] = {}
    for name, values in ranks(scores).items():
        steps = [(k + 1) / len(values) - value for k, value in enumerate(values)]
        quantity = name.rpartition(",")[0]
        label = None if quantity in colours else quantity
        colour = colours.setdefault(quantity, f"C{len(colours)}")
        axes.step([0, *values, 1], [0, *steps, 0], where="post", label=label, lw=1, color=colour)
    edge = 1.358 / len(scores) ** 0.5  # 95 % quantile of Kolmogorov's distribution
    axes.axhspan(-edge, edge, color=style.BAND, alpha=0.3, lw=0, label="uniform, 95 %")
    axes.set_xlabel("rank of the truth in its band")
    axes.set_ylabel("fraction of draws below, minus rank")
    style.legend_below(figure, axes)
    return figure

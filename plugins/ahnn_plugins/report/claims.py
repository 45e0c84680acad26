"""The paper's claims as data, paraphrased: ratios of scores and their intervals.

`An order of magnitude` is a factor of at least sqrt(10), which rounds to ten in powers of ten, and `two
orders` one of at least 10 sqrt(10), as the paper's own numbers require. `Comparable` means within a factor of
two.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import product

from ahnn.evaluation.case import Start
from ahnn_plugins.report.paper import MODELS
from ahnn_plugins.report.scores import Measure
from ahnn_plugins.report.verdicts import Claim, Demand

STATE = ("position", "velocity")
STARTS: tuple[Start, ...] = ("true", "perturbed")
STRUCTURED = ("HNN", "AHNN3", "AHNN5")
PLAIN = ("MLP", "NODE")
ALIKE = 2.0
"""Factor within which scores are comparable."""


def below(
    one: str,
    other: str,
    quantities: Iterable[str] = STATE,
    starts: Iterable[Start] = ("true",),
    *,
    filtered: bool = False,
    orders: int = 0,
) -> tuple[Demand, ...]:
    """Build the demands that one model's errors are below another's, by a number of orders of magnitude."""
    high = 10 ** (0.5 - orders) if orders else 1.0
    pairs = product(quantities, starts)
    return tuple(
        Demand(Measure(one, q, s, filtered), Measure(other, q, s, filtered), 0.0, high) for q, s in pairs
    )


def alike(one: str, other: str, quantities: Iterable[str] = STATE) -> tuple[Demand, ...]:
    """Build the demands that errors of two models are comparable, from the true start without a filter."""
    return tuple(Demand(Measure(one, q), Measure(other, q), 1 / ALIKE, ALIKE) for q in quantities)


def best(model: str, starts: Iterable[Start], *, filtered: bool) -> tuple[Demand, ...]:
    """Build the demands that a model is better than each other model."""
    starts = tuple(starts)
    others = (other for other in MODELS if other != model)
    return tuple(d for other in others for d in below(model, other, STATE, starts, filtered=filtered))


def improved(model: str, orders: int = 0) -> tuple[Demand, ...]:
    """Build the demands that the filter improves a model from both starts."""
    high = 10 ** (0.5 - orders) if orders else 1.0
    return tuple(
        Demand(Measure(model, q, s, True), Measure(model, q, s), 0.0, high) for s, q in product(STARTS, STATE)
    )


def joined(*parts: tuple[Demand, ...]) -> tuple[Demand, ...]:
    """Concatenate the demands of several parts."""
    return tuple(demand for part in parts for demand in part)


SPRING = (
    Claim(
        "spring-best",
        "mass_spring",
        "AHNN5 predicts best of all models from the true start.",
        "Section 5.3, Table 1",
        best("AHNN5", ("true",), filtered=False),
    ),
    Claim(
        "spring-node",
        "mass_spring",
        "NODE is fifteen times as accurate as MLP from the true start (judged: between ten and 22.5 times).",
        "Section 5.3",
        tuple(Demand(Measure("MLP", q), Measure("NODE", q), 10.0, 22.5) for q in STATE),
    ),
    Claim(
        "spring-hnn",
        "mass_spring",
        "HNN is more accurate than NODE.",
        "Section 5.3",
        below("HNN", "NODE"),
    ),
    Claim(
        "spring-comparable",
        "mass_spring",
        "AHNN3 is comparable to HNN: the system is simple.",
        "Section 5.3",
        alike("AHNN3", "HNN"),
    ),
    Claim(
        "spring-energy",
        "mass_spring",
        "HNN, AHNN3 and AHNN5 conserve energy better than MLP and NODE.",
        "Section 5.3, Figure 5",
        joined(*(below(a, b, ("energy",)) for a, b in product(STRUCTURED, PLAIN))),
    ),
    Claim(
        "spring-filter",
        "mass_spring",
        "The UKF improves every model, from both starts.",
        "Section 5.3, Table 1",
        joined(*map(improved, MODELS)),
    ),
    Claim(
        "spring-filter-best",
        "mass_spring",
        "AHNN5 with the UKF is the best of all filters, from both starts.",
        "Section 5.3, Table 1",
        best("AHNN5", STARTS, filtered=True),
    ),
)
ORBIT = (
    Claim(
        "orbit-hnn",
        "molniya",
        "HNN is an order of magnitude more accurate than MLP and NODE from the true start.",
        "Section 5.3, Table 2",
        joined(*(below("HNN", other, orders=1) for other in PLAIN)),
    ),
    Claim(
        "orbit-ahnn",
        "molniya",
        "AHNN5 is an order of magnitude more accurate than HNN from the true start.",
        "Section 5.3, Table 2",
        below("AHNN5", "HNN", orders=1),
    ),
    Claim(
        "orbit-best",
        "molniya",
        "AHNN5 predicts best of all models from the true start.",
        "Table 2",
        best("AHNN5", ("true",), filtered=False),
    ),
    Claim(
        "orbit-energy",
        "molniya",
        "HNN, AHNN3 and AHNN5 conserve energy two orders of magnitude better than MLP and NODE.",
        "Section 5.3, Figure 7",
        joined(*(below(a, b, ("energy",), orders=2) for a, b in product(STRUCTURED, PLAIN))),
    ),
    Claim(
        "orbit-energy-alike",
        "molniya",
        "HNN, AHNN3 and AHNN5 conserve energy comparably well.",
        "Section 5.3",
        joined(*(alike(a, b, ("energy",)) for a, b in (("AHNN3", "HNN"), ("AHNN5", "HNN")))),
    ),
    Claim(
        "orbit-filter",
        "molniya",
        "The UKF improves every model, from both starts.",
        "Section 5.3, Table 2",
        joined(*map(improved, MODELS)),
    ),
    Claim(
        "orbit-filter-best",
        "molniya",
        "AHNN5 with the UKF is the best of all filters, from both starts.",
        "Section 5.3, Table 2",
        best("AHNN5", STARTS, filtered=True),
    ),
    Claim(
        "orbit-filter-hnn",
        "molniya",
        "AHNN3 and AHNN5 with the UKF are two orders of magnitude more accurate than HNN with the UKF.",
        "Appendix",
        joined(*(below(a, "HNN", STATE, STARTS, filtered=True, orders=2) for a in ("AHNN3", "AHNN5"))),
    ),
    Claim(
        "orbit-filter-alike",
        "molniya",
        "HNN does not gain from the UKF (judged: position and velocity from the true start are no smaller).",
        "Appendix; the text of Section 5.3 says the opposite",
        tuple(Demand(Measure("HNN", q, "true", True), Measure("HNN", q), 1.0, math.inf) for q in STATE),
    ),
    Claim(
        "orbit-node",
        "molniya",
        "NODE is not robust: a perturbed start makes its error larger by an order of magnitude.",
        "Section 5.3, Table 2",
        tuple(
            Demand(Measure("NODE", q, "perturbed"), Measure("NODE", q), math.sqrt(10), math.inf)
            for q in STATE
        ),
    ),
)
CLAIMS = (*SPRING, *ORBIT)

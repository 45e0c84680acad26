"""One-step integrators: each method is a table of coefficients, and each family of methods one loop.

Explicit Runge-Kutta methods, symmetric symplectic compositions and one implicit Gauss method, all batched,
differentiable and stateless. A new method requires its coefficients and a line in `OWN`.
"""

from __future__ import annotations

from difflib import get_close_matches
from typing import Any

from ahnn.arguments import check_arguments
from ahnn.errors import UserError
from ahnn.extensions import Table
from ahnn.integrators import compositions, tableaus
from ahnn.integrators.base import Integrator, column
from ahnn.integrators.explicit import ExplicitRungeKutta
from ahnn.integrators.implicit import GaussLegendre4
from ahnn.integrators.symplectic import SymmetricComposition

OWN = (
    ExplicitRungeKutta("euler", 1, tableaus.EULER),
    ExplicitRungeKutta("midpoint", 2, tableaus.MIDPOINT),
    ExplicitRungeKutta("rk4", 4, tableaus.RK4),
    ExplicitRungeKutta("dopri5", 5, tableaus.DOPRI5),
    ExplicitRungeKutta("dopri8", 8, tableaus.DOPRI8),
    GaussLegendre4(),
    SymmetricComposition("leapfrog", 2, compositions.LEAPFROG),
    SymmetricComposition("yoshida4", 4, compositions.YOSHIDA4),
    SymmetricComposition("yoshida6", 6, compositions.YOSHIDA6),
    SymmetricComposition("yoshida8", 8, compositions.YOSHIDA8),
    SymmetricComposition("kahan_li6", 6, compositions.KAHAN_LI6),
    SymmetricComposition("kahan_li8", 8, compositions.KAHAN_LI8),
)
INTEGRATORS: Table[Integrator] = Table("ahnn.integrators", {method.name: method for method in OWN})
"""Methods by name, including those declared by installed packages in the entry-point group."""


def make_integrator(name: str, **options: Any) -> Integrator:
    """Build the integrator of a given name.

    Args:
        name: a key of `INTEGRATORS`.
        options: `tolerance` and `max_iterations` of gl4; no other method has options.

    Raises:
        UserError: unknown name or option.
    """
    if name not in INTEGRATORS:
        close = get_close_matches(str(name), INTEGRATORS, n=1)
        hint = f"; did you mean {close[0]}?" if close else ""
        message = f"integrator: expected one of {', '.join(INTEGRATORS)}; received {name!r}{hint}"
        raise UserError(message)
    if not options:
        return INTEGRATORS[name]
    if name != "gl4":
        message = f"integrator {name}: unknown option {sorted(options)[0]!r}; only gl4 has options"
        raise UserError(message)
    check_arguments(f"integrator {name}", GaussLegendre4, options, ("name", "order"))
    return GaussLegendre4(**options)


__all__ = [
    "INTEGRATORS",
    "ExplicitRungeKutta",
    "GaussLegendre4",
    "Integrator",
    "SymmetricComposition",
    "column",
    "make_integrator",
]

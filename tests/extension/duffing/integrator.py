"""An integrator: the method of third order of Ralston (1962, Math. Comp. 16, 431-437)."""

from ahnn.integrators import ExplicitRungeKutta
from ahnn.integrators.tableaus import ButcherTableau

RALSTON = ExplicitRungeKutta(
    "ralston", 3, ButcherTableau(a=((1 / 2,), (0.0, 3 / 4)), b=(2 / 9, 3 / 9, 4 / 9))
)

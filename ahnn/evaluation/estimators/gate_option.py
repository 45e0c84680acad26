"""The option `gate` of an estimator: what evaluations and what streams refuse as outliers."""

from __future__ import annotations

from typing import Annotated, Literal

from ahnn.arguments import Within
from ahnn.estimation.gate import Gate

GateOption = Annotated[float, Within(above=0, below=1)] | Literal["streams"] | None
STREAM_GATE = 0.9999
"""Probability beyond which a stream refuses a measurement where nothing else is said.

One in ten thousand of the rows that a right model and a right noise explain is refused, too.
"""


def chosen_gates(option: GateOption, patience: float) -> tuple[Gate | None, Gate | None]:
    """Return the gates of evaluations and of streams; None takes all.

    Args:
        option: a probability, for both; `streams`, which are gated alone; or None for neither.
        patience: refusals in a row after which a member has diverged.
    """
    if option is None:
        return None, None
    if option == "streams":
        return None, Gate(STREAM_GATE, int(patience))
    gate = Gate(option, int(patience))
    return gate, gate

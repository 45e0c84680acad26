"""Messages on the sweeps of Hydra's grammar, such as interval(1e-3, 3e-2), written with a mistake."""

from __future__ import annotations

import re

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException

FUNCTION = re.compile(r"\s*(choice|range|interval|glob|tag|sort|shuffle)\s*\(.*", re.DOTALL)
FORMS = {
    "choice": "choice(A, B, ...)",
    "range": "range(START, STOP, STEP)",
    "interval": "interval(LOW, HIGH)",
    "glob": "glob(PATTERN)",
    "tag": "tag(NAME, SWEEP)",
    "sort": "sort(A, B, ...)",
    "shuffle": "shuffle(SWEEP)",
}
GAP = re.compile(r"(?<=[\w.)\]])\s+(?=[\w.+\-(\[])")
"""White space between two values, where a comma belongs."""


def sweep_fault(text: str) -> str | None:
    """Return what is wrong with the sweep in KEY=VALUE, and how to write it; None for another value.

    Args:
        text: an override that Hydra refuses, or takes as a text.
    """
    key, _, value = text.partition("=")
    found = FUNCTION.fullmatch(value.strip("'\" "))
    if found is None:
        return None
    value, form = value.strip("'\" "), FORMS[found[1]]
    missing = value.count("(") - value.count(")")
    if missing > 0:
        fault, better = "a closing parenthesis is missing", value + ")" * missing
    elif GAP.search(value):
        fault, better = "a comma is missing", value
    else:
        fault, better = "its arguments do not fit", value
    better = GAP.sub(", ", better)
    if not _is_sweep(f"{key}={better}"):
        return f"{text!r}: expected {form}; {fault}"
    if better == value:
        return f"{text!r}: expected {form} without quotes inside the value. Type '{key}={better}'"
    return f"{text!r}: expected {form}; {fault}. Type '{key}={better}'"


def _is_sweep(text: str) -> bool:
    try:
        return OverridesParser.create().parse_override(text).is_sweep_override()
    except HydraException:
        return False

"""Selection of smoothers by the evaluation option `smoother`."""

from __future__ import annotations

from typing import Any

from ahnn.errors import UserError
from ahnn.estimation.estimator import Estimator


def asked_smoothers(asked: bool | str, estimator: Estimator[Any]) -> list[str]:
    """Return the names of smoothers: none, the first, or all up to a named one.

    Raises:
        UserError: the name is unknown, or the estimator has no smoother.
    """
    known = [*estimator.smoothers]
    if asked is False:
        return []
    if not known:
        message = f"smoother: expected false, since {estimator.name} has none; received {asked}"
        raise UserError(message)
    if isinstance(asked, str) and asked not in known:
        message = f"smoother: expected true, false or one of {', '.join(known)}; received {asked}"
        raise UserError(message)
    return known[: known.index(asked) + 1] if isinstance(asked, str) else known[:1]

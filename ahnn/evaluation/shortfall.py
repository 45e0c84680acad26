"""Remark on a training on measurements that ended far from its optimum, the first cause of poor residuals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

FAR = 2.0
"""Validation loss of the training, 1 for pure noise, above which its end may be far from the optimum."""
DROP = 2.0
"""Factor of the decrease in the closing stage alone, above which it is: a wrong noise level leaves none."""
LONGER = 4
"""Factor between the epochs that were trained and those of the remedy."""


def shortfall(about: Mapping[str, Any]) -> str:
    """Return the remark on a training of which the closing stage more than halved the loss; "" for others.

    Args:
        about: metadata of the weights: `val_loss` at the end, and `trained`, with the `loss` before the
            closing stage and the number of `epochs`; older weights lack it.
    """
    trained, last = about.get("trained") or {}, about.get("val_loss")
    before, epochs = trained.get("loss"), trained.get("epochs")
    if before is None or last is None or epochs is None or before < max(FAR, DROP * last):
        return ""
    return (
        f"the training ended far from its optimum: validation loss {before:.3g} (1: noise alone) after "
        f"{epochs} {'epoch' if epochs == 1 else 'epochs'}, and {last:.3g} after the closing stage. Train "
        f"longer first: trainer.max_epochs={LONGER * epochs}"
    )

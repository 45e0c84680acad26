"""Hooks of every step that nobody listens to."""

from __future__ import annotations

from typing import Any


class Unheard:
    """Callbacks and modules that hear of no step unless they define the hook.

    Lightning looks each hook up and calls it if it can be called: None in place of its own empty methods
    saves the call and what surrounds it. `super()` has nothing to call here.
    """

    on_train_batch_start: Any = None
    on_train_batch_end: Any = None
    on_before_zero_grad: Any = None
    on_before_backward: Any = None
    on_after_backward: Any = None
    on_before_optimizer_step: Any = None

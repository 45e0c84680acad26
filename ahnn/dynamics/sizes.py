"""Limit on the size of modules during construction, from the tensors that will fill them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from torch import Tensor
from torch.nn.modules.module import (
    register_module_buffer_registration_hook,
    register_module_parameter_registration_hook,
)

from ahnn.errors import UserError


@contextmanager
def fillable(state: Mapping[str, Tensor]) -> Iterator[None]:
    """Reject modules built in this context with more than twice the available tensors or numbers.

    Sizes in the metadata of weights are untrusted; a module registers each tensor before it is filled. The
    factor of two allows for modules that register a tensor again.

    Raises:
        UserError: as soon as the limit is exceeded.
    """
    tensors, numbers = 2 * len(state), 2 * sum(tensor.numel() for tensor in state.values())

    def count(module: Any, name: str, tensor: Tensor | None) -> None:
        nonlocal tensors, numbers
        del module, name
        if tensor is None:
            return
        tensors, numbers = tensors - 1, numbers - tensor.numel()
        if tensors < 0 or numbers < 0:
            message = f"dynamics: expected sizes that match the {len(state)} tensors; received larger sizes"
            raise UserError(message)

    hooks = [
        register(count)
        for register in (
            register_module_parameter_registration_hook,
            register_module_buffer_registration_hook,
        )
    ]
    try:
        yield
    finally:
        for hook in hooks:
            hook.remove()

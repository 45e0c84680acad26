"""Import of libraries required only by demonstrations."""

from __future__ import annotations

import importlib
from typing import Any

from ahnn.errors import UserError


def require(module: str, extra: str) -> Any:
    """Import a module of an optional library; raises UserError that names the extra to install."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        message = (
            f"system: expected the package {module.partition('.')[0]}; received none. Install it with "
            f"pip install 'ahnn[{extra}]'"
        )
        raise UserError(message) from error

"""Libraries that only some formats need."""

from __future__ import annotations

import importlib
from typing import Any

from ahnn.errors import UserError


def library(module: str, package: str, extra: str, purpose: str) -> Any:
    """Return a module of an optional package.

    Args:
        module: its name.
        package: that has it.
        extra: of ahnn that installs it.
        purpose: what it is needed for.

    Raises:
        UserError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        message = f"{purpose}: expected the package {package}; received none. pip install 'ahnn[{extra}]'"
        raise UserError(message) from error

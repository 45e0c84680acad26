"""Import of optional libraries required by some formats."""

from __future__ import annotations

import importlib
from typing import Any

from ahnn.errors import UserError


def library(module: str, package: str, extra: str, purpose: str) -> Any:
    """Import a module of an optional package.

    Args:
        module: module name.
        package: package that contains it.
        extra: extra of ahnn that installs it.
        purpose: purpose, for the message.

    Raises:
        UserError: the package is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        message = (
            f"{purpose}: expected the package {package}; received none. Install it with pip install "
            f"'ahnn[{extra}]'"
        )
        raise UserError(message) from error

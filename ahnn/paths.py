"""Locations of the configuration and of the user's cache."""

from __future__ import annotations

import os
from pathlib import Path


def conf_dir() -> Path:
    """Return the folder of train.yaml and the config groups.

    Raises:
        FileNotFoundError: the installation is incomplete.
    """
    package = Path(__file__).resolve().parent
    for candidate in (package / "conf", package.parent / "conf"):
        if (candidate / "train.yaml").is_file():
            return candidate
    message = f"expected conf/train.yaml in {package} or next to it; received neither. Install ahnn again."
    raise FileNotFoundError(message)


def cache_dir() -> Path:
    """Return the folder of generated data and compiled code: `$AHNN_CACHE`, by default `~/.cache/ahnn`."""
    return Path(os.path.expanduser(os.environ.get("AHNN_CACHE") or "~/.cache/ahnn"))  # no home is needed

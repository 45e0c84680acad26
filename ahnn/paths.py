"""Where the configuration lives: inside an installed wheel, or beside the package in a checkout."""

from __future__ import annotations

from pathlib import Path


def conf_dir() -> Path:
    """Return the folder that holds train.yaml and the config groups.

    Raises:
        FileNotFoundError: the installation is incomplete.
    """
    package = Path(__file__).resolve().parent
    for candidate in (package / "conf", package.parent / "conf"):
        if (candidate / "train.yaml").is_file():
            return candidate
    message = f"expected conf/train.yaml in or beside {package}; received neither. Install ahnn again."
    raise FileNotFoundError(message)

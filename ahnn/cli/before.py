"""Before the fit: settings that can be, a quiet Lightning, and a folder that holds no other training."""

from __future__ import annotations

import logging
import warnings
from pathlib import Path

from omegaconf import DictConfig

from ahnn.cli.importing import import_torchmetrics, importing
from ahnn.cli.settings import check_settings
from ahnn.cli.stops import held
from ahnn.errors import UserError

HINTS = (
    ".*smaller than the logging interval.*",
    ".*does not have many workers.*",
    ".*Checkpoint directory.*exists.*",
    ".*ModelCheckpoint with manual optimization.*",
    ".*isinstance.treespec, LeafSpec.*",
    ".*did not find any unused parameters.*",
    ".*srun. command is available on your system but is not used.*",
    "GPU available but not used.*",
)
"""What Lightning warns of though it is intended, such as short epochs or a login node without `srun`."""


def begin(cfg: DictConfig) -> None:
    """Check the settings of a job, and only then import what is heavy.

    Raises:
        UserError: a setting that is impossible.
    """
    check_settings(cfg)
    with importing():
        quiet()


def quiet() -> None:
    """Silence Lightning's warnings about what is intended."""
    with held():
        import_torchmetrics()
        from lightning.pytorch.utilities import rank_zero_only

    for name in ("lightning.pytorch", "lightning.fabric"):
        logging.getLogger(name).setLevel(logging.WARNING)
    if getattr(rank_zero_only, "rank", 0):  # of several processes, one speaks
        logging.getLogger("ahnn").setLevel(logging.WARNING)
    for hint in HINTS:
        warnings.filterwarnings("ignore", hint)


def require_new(folder: Path, ckpt: str | None) -> None:
    """Check that a training from the start replaces no other.

    Raises:
        UserError: the folder holds checkpoints.
    """
    found = sorted(path.name for path in (folder / "checkpoints").glob("*.ckpt"))
    if found and ckpt is None:
        message = (
            f"run {folder}: expected a folder without checkpoints; received one with {', '.join(found)}. "
            "Resume with ckpt=last, or choose another run="
        )
        raise UserError(message)

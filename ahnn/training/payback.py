"""Whether a training compiles its optimiser steps: what it needs for that, and whether it pays back.

On a GPU it records them instead, which takes a second or two.
"""

from __future__ import annotations

import logging
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any, Literal, cast

from ahnn.data.datamodule import WindowDataModule
from ahnn.dynamics import Dynamics, HamiltonianDynamics
from ahnn.errors import UserError
from ahnn.integrators import GaussLegendre4
from ahnn.training.compilation import compiled, price
from ahnn.training.compiled import Compiled
from ahnn.training.objectives import Derivative, Objective, Recursive
from ahnn.training.outlook import step_seconds
from ahnn.training.replayed import replayed
from ahnn.training.tracing import Compared, traced
from ahnn.types import Window

log = logging.getLogger(__name__)

SAVED = 0.4
"""Part of an optimiser step that compiled code saves, at least (docs/benchmarks.md)."""
SAVED_IN_C = 0.1
"""The same where the step is in C anyway."""
DEVICE = "trainer.accelerator"
WORTH = 60.0
"""Seconds below which nothing is tried: the compiler's modules alone take some to load."""


def require_compilable(trainer: Any, model: Any) -> None:
    """Refuse a training whose steps cannot be compiled.

    Raises:
        UserError: names the setting and its remedy.
    """
    for name, fits, expected, received in _conditions(trainer, model):
        if not fits:
            message = f"{name}: expected {expected} with compile=true; received {received}. Set compile=auto"
            raise UserError(message)


def _conditions(trainer: Any, model: Any) -> list[tuple[str, bool, str, Any]]:
    """Return setting, whether it fits, what would, and what it is."""
    dynamics, device = model.dynamics, trainer.strategy.root_device.type
    integrator = getattr(dynamics, "integrator", None)
    fixed = _is_own(dynamics) and (integrator is None or _is_own(integrator))
    objectives = [type(phase.objective) for phase in model.curriculum.phases]
    known = all(kind in (Recursive, Derivative) for kind in objectives)
    return [
        ("optimizer", model.automatic_optimization, "one that takes gradients", "levenberg_marquardt"),
        ("loss", known, "recursive predictions or derivatives", ", ".join(k.__name__ for k in objectives)),
        ("model", fixed, "dynamics of ahnn, whose operations are always the same,", type(dynamics).__name__),
        ("integrator", not isinstance(integrator, GaussLegendre4), "an explicit method", "gl4"),
        (DEVICE, device == "cpu", "cpu", device),
        ("trainer.devices", trainer.world_size == 1, "one", trainer.world_size),
        ("trainer.precision", trainer.precision == "32-true", "its default", trainer.precision),
    ]


def _is_own(part: object) -> bool:
    return type(part).__module__.startswith("ahnn.")


def choose(
    asked: Literal["auto"] | bool,
    trainer: Any,
    data: WindowDataModule,
    model: Any,
    cache: Path,
    before: bool | None = None,
) -> None:
    """Let a model compile its optimiser steps, if that is asked for or pays back within the training.

    Args:
        asked: auto, or what holds.
        trainer: of the training.
        data: of the training.
        model: calibrated.
        cache: folder of generated data, in which compiled code is kept.
        before: whether steps were compiled where this training began, if it is resumed; they round
            differently.
    """
    failing = [name for name, fits, *_ in _conditions(trainer, model) if not fits]
    on_gpu, make = trainer.strategy.root_device.type == "cuda", partial(compiled, cache=cache)
    if asked == "auto" and failing == [DEVICE] and on_gpu:
        asked, make = False, replayed
    elif asked == "auto":
        asked = before if before is not None else not failing and _pays_back(trainer, data, model, cache)
    if asked or make is replayed:
        model.compiled = Compiled(len(data.train_dataloader().batches()[0]), make)
    model.about["compiled"] = asked


def _pays_back(trainer: Any, data: WindowDataModule, model: Any, cache: Path) -> bool:
    """Return whether compiled steps save more time than their compilation takes, and say so."""
    per_epoch = len(data.train_dataloader())
    epochs = int(trainer.max_epochs or 1)
    counts = Counter(model.curriculum.at(epoch, epochs) for epoch in range(epochs))
    total = sum(n * per_epoch * step_seconds(model, data, objective) for objective, n in counts.items())
    saved = total * (SAVED_IN_C if _in_c(model.dynamics) else SAVED)
    if saved < WORTH:
        return False
    cost = sum(_price(model, data, objective, cache) for objective in counts)
    pays = cost < saved
    log.info(
        "compile: auto %s the optimiser steps: about %.0f s of compilation, about %.0f s saved",
        "compiles" if pays else "does not compile",
        cost,
        saved,
    )
    return pays


def _in_c(dynamics: Dynamics) -> bool:
    return isinstance(dynamics, HamiltonianDynamics) and dynamics.in_c()


def _price(model: Any, data: WindowDataModule, objective: Objective, cache: Path) -> float:
    """Return about how long the compilation for an objective takes."""
    loader = data.train_dataloader()
    batch = cast(Window, loader.gather(loader.batches()[0]))
    return price(traced(Compared(objective, model.loss, model.dynamics), batch), cache)

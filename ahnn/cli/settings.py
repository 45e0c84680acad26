"""Settings that belong to no group, and those that nothing looks at before a training is over."""

from __future__ import annotations

import math

from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import check_arguments, check_names
from ahnn.cli.build import plain_config
from ahnn.errors import UserError

SEEDS = (0, 2**32 - 1)
LIMITS = {
    **dict.fromkeys(("seed", "seeds", "data.seed", "data.order_seed", "evaluation.seed"), SEEDS),
    "threads": (1, 1024),
    **dict.fromkeys(("trainer.max_epochs", "trainer.accumulate_grad_batches"), (1, math.inf)),
}
"""Least and largest values of numbers that other libraries take unseen and fail on later."""

GIVEN = ("model", "data", "plugins", "about", "loggers", "label", "folder", "settings")
"""What the evaluation gets from a training and not from its own part of the configuration."""


def check_settings(cfg: DictConfig) -> None:
    """Check the keys that belong to no group, and those that nothing looks at before a training is over.

    Raises:
        UserError: a wrong type or an impossible value.
    """

    def settings(
        *, seed: int, seeds: list[int] | None, threads: int, window: int, label: str, ckpt: str | None
    ) -> None: ...

    def judged(*, seed: int, save_predictions: bool, figures: bool, detail: bool) -> None: ...

    def trainer(*, max_epochs: int) -> None: ...

    top = {name: cfg[name] for name in ("seed", "threads", "window", "label", "ckpt")}
    top = plain_config(OmegaConf.create({**top, "seeds": cfg.get("seeds")}))
    check_arguments("configuration", settings, top)
    check_arguments("trainer", trainer, {"max_epochs": cfg.trainer.max_epochs})
    evaluation = plain_config(cfg.evaluation, "evaluation")
    check_names("evaluation", judged, evaluation)
    check_arguments("evaluation", judged, evaluation)
    for name, (least, most) in LIMITS.items():
        value = OmegaConf.select(cfg, name)
        for number in value if name == "seeds" and value else [value]:
            if isinstance(number, int | float) and not least <= number <= most:
                message = f"configuration: {name}: expected {least} <= n <= {most}; received {number}"
                raise UserError(message)
    if cfg.get("seeds") and len({*cfg.seeds}) < len(cfg.seeds):
        message = f"configuration: seeds: expected different ones; received {list(cfg.seeds)}"
        raise UserError(message)

"""A Hydra application with the keys that the sweeps use and an objective that costs nothing."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

import hydra
from omegaconf import DictConfig


@hydra.main(version_base=None, config_path="toy_conf", config_name="toy")
def main(cfg: DictConfig) -> float:
    number = int(Path(hydra.core.hydra_config.HydraConfig.get().runtime.output_dir).name)
    mark = Path(hydra.core.hydra_config.HydraConfig.get().sweep.dir) / f"killed-{number}"
    trial = hydra.utils.instantiate(cfg.trial)
    loss = 0.0
    for epoch in range(4):
        loss = (cfg.x - 0.3) ** 2 + 0.1 * cfg.optimizer.lr / (epoch + 1)
        if trial is not None:
            trial.report(loss, epoch)
        time.sleep(cfg.sleep)
        if cfg.prune_above is not None and epoch == 2 and cfg.x > cfg.prune_above:
            from optuna import TrialPruned

            raise TrialPruned("too large")
    if number in cfg.raising or cfg.x == cfg.raise_at:
        raise RuntimeError("this job was made to fail")
    if number in cfg.killed and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    sys.stdout.write(f"job {number} done\n")
    return loss


if __name__ == "__main__":
    main()

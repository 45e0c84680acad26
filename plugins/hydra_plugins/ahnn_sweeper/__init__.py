"""Optuna in Hydra's multirun: pruning, resume, many workers (`hydra/sweeper=ahnn_optuna`).

`sweeper` requests trials and launches them, and `launcher` runs each job in a separate process. The parts are
in modules whose names begin with an underscore, which Hydra's plugin scan skips. A job finds its trial
through the node `trial` of its configuration, from which `load_trial` creates an `optuna.Trial`.
"""

from hydra_plugins.ahnn_sweeper._trial import load_trial

__all__ = ["load_trial"]

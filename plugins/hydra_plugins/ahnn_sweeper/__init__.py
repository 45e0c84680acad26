"""Optuna in Hydra's multirun: pruning, resume, many workers (`hydra/sweeper=ahnn_optuna`).

`sweeper` requests trials and launches them, `launcher` runs each job in a separate process; modules with an
underscore, skipped by Hydra's plugin scan, contain the parts. A job finds its trial through the node `trial`
of its configuration, which instantiates to an `optuna.Trial` by `load_trial`.
"""

from hydra_plugins.ahnn_sweeper._trial import load_trial

__all__ = ["load_trial"]

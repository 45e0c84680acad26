"""Predicted Final Loss (PFL) pruner: stop a run whose extrapolated loss cannot compete.

`predictor` forecasts a curve, `decision` contains the rule, `pruner` applies it to an Optuna study, `record`
stores final losses of a plain grid, and `callback` integrates the rule into a Lightning run; `log` writes and
replays the decisions.
"""

from ahnn_plugins.pfl.callback import PFLCallback
from ahnn_plugins.pfl.decision import Decision, Settings, decide
from ahnn_plugins.pfl.log import replay
from ahnn_plugins.pfl.pruner import PFLPruner

__all__ = ["Decision", "PFLCallback", "PFLPruner", "Settings", "decide", "replay"]

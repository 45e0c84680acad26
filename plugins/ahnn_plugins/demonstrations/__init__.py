"""Demonstrations on external data: planetary ephemerides, and satellites on Molniya orbits.

`planets` and `satellites` are sources of trajectories; `attraction` and `horizon` evaluate models learned
from them. The sources need the extras `ephemeris` and `orbit`.
"""

from ahnn_plugins.demonstrations.attraction import Attraction
from ahnn_plugins.demonstrations.horizon import Horizon
from ahnn_plugins.demonstrations.planets import Planets
from ahnn_plugins.demonstrations.satellites import Satellites

__all__ = ["Attraction", "Horizon", "Planets", "Satellites"]

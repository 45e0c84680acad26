"""Units of the columns of an assimilation's output, for its sidecar."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ahnn.assimilation.stream_sensor import StreamSensor
from ahnn.data.estimate_table import COVARIANCE, DEVIATION, INNOVATION
from ahnn.data.files.sidecar import Sidecar
from ahnn.data.files.units import product

NUMBERS = "nis", "dof", "replayed", "novelty", "probability"
"""Columns of pure numbers."""


def with_row_units(
    said: Sidecar, components: tuple[str, ...], sensors: Mapping[str, StreamSensor], written: Iterable[str]
) -> Sidecar:
    """Return a sidecar with the units of the columns derived from components and measured values.

    Args:
        said: sidecar with the units of time and of the components.
        components: names of the D components of the state.
        sensors: sensors by name, whose innovations are in the units of their measurements.
        written: names of the columns.
    """
    own = {name: said.units[name] for name in components if name in said.units}
    found = {f"{COVARIANCE}{a}_{b}": product(own[a], own[b]) for a in own for b in own}
    for sensor in sensors.values():
        for name, unit in zip(sensor.columns, sensor.measurement.units, strict=False):
            for prefix in (INNOVATION, DEVIATION):
                found.setdefault(prefix + name, unit)
    for name, unit in own.items():
        found |= {f"lag_{name}": unit, f"lag_sd_{name}": unit}
    found["lag_time"] = said.units.get("time", "")
    found |= dict.fromkeys(NUMBERS, "1")
    units = {name: found[name] for name in written if found.get(name)}
    return said._replace(units={**said.units, **units})

"""Parsing of text lines into instrument readings."""

from __future__ import annotations

import csv
import json
import logging
import math
from collections.abc import Mapping
from typing import Any

from ahnn.arguments import nearest
from ahnn.assimilation.cells import BadLine, is_missing, number, require_object_column, unique
from ahnn.assimilation.instrument_reading import Reading
from ahnn.assimilation.stream_clock import StreamClock
from ahnn.assimilation.stream_sensor import StreamSensor
from ahnn.assimilation.unit_mistakes import ELEVATION, steep_elevation
from ahnn.data.files.columns import control_named
from ahnn.data.files.table import FINITE, LARGEST, column_of
from ahnn.data.files.units import factor
from ahnn.errors import UserError

log = logging.getLogger("ahnn")

TIME, SENSOR, SD = ("time", "t"), "sensor", "sd_"
"""Column names of time and sensor; prefix of standard deviations."""
OTHER_NAMES = {"station": SENSOR, "epoch": TIME[0]}
RESERVED = frozenset(',"\n\r')
"""Characters not allowed in an object name, which must be usable as a table cell."""


class Layout:
    """Line format of a stream: JSON objects, or cells under a header.

    Args:
        first: first line of the stream.
        sensors: sensors by name.
        clock: interpretation of times; None for plain numbers.
        controls: names of the controls of the model.
        objects: name of the column of object names; "" for a single object.

    Raises:
        UserError: a header without time, with a column that no sensor has or in an incompatible unit, or with
            values of unknown standard deviation.
    """

    def __init__(
        self,
        first: str,
        sensors: Mapping[str, StreamSensor],
        clock: StreamClock | None = None,
        controls: tuple[str, ...] = (),
        objects: str = "",
    ) -> None:
        self.sensors, self.clock, self.controls, self.objects = sensors, clock, controls, objects
        self.only = next(iter(sensors)) if len(sensors) == 1 else None
        self.measured = {key for sensor in sensors.values() for key in _keys(sensor)}
        self.known = {*TIME, SENSOR, *controls, *self.measured}
        if objects in self.known:
            message = (
                f"objects: expected a column other than {', '.join(sorted(self.known))}; received {objects}"
            )
            raise UserError(message)
        self.known |= {objects} - {""}
        self.foreign = {key: self.measured - _keys(sensor) for key, sensor in sensors.items()}
        if clash := ", ".join(self.measured & {*controls}):
            message = f"measurements: expected sensors that do not measure controls; received {clash}"
            raise UserError(message)
        self.said: set[tuple[str, str]] = set()
        self.levelled = False  # whether some elevation was within its limits
        self.names: list[str] | None = None
        self.scales: dict[str, float] = {}
        self.units: dict[str, str] = {}
        if "\r" in first.strip():
            message = (
                "measurements: expected lines that end with LF; received CR. Convert them with tr '\\r' '\\n'"
            )
            raise UserError(message)
        if not first.lstrip().startswith("{"):
            self.delimiter = max(",;\t", key=first.count)
            try:
                cells = self._split(first)
                require_object_column(objects, cells)
                self.names = [self._name(cell) for cell in cells]
            except BadLine as error:
                message = f"measurements: expected a header; received {first[:40]!r} ({error})"
                raise UserError(message) from error
            whole = len({*TIME} & {*self.names}) == 1 and {objects} <= {"", *self.names}
            if len({*self.names}) < len(self.names) or not whole:
                expected = f"a header with {self._expected()}, each once"
                message = f"measurements: expected {expected}; received {first.strip()!r}"
                raise UserError(message)
            self._check_columns({*self.names})

    def reading(self, text: str) -> Reading:
        """Parse a line into a reading.

        Raises:
            BadLine: the line is not a valid measurement.
        """
        return self.reading_of(self.row(text))

    def row(self, text: str) -> dict[str, Any]:
        """Split a line into values by column name; raises BadLine."""
        return self._cells(text) if self.names else self._object(text)

    def object_of(self, row: dict[str, Any]) -> str:
        """Return the object name of a row; raises BadLine."""
        cell = row.get(self.objects)
        name = "" if is_missing(cell) or isinstance(cell, bool) else str(cell).strip()
        if not name or not isinstance(cell, str | int) or not {*name}.isdisjoint(RESERVED):
            expected = "an object name without commas or quotes"
            message = f"{self.objects}: expected {expected}; received {str(cell)[:40]!r}"
            raise BadLine(message)
        return name

    def reading_of(self, row: dict[str, Any]) -> Reading:
        """Parse a row into a reading; raises BadLine."""
        name, time, controls = row.get(SENSOR) or self.only, self._time(row), self._controls(row)
        if name is None and all(is_missing(row[key]) for key in row.keys() & self.measured):
            return Reading(time, controls=controls)
        if not isinstance(name, str) or name not in self.sensors:
            expected, guess = ", ".join(self.sensors), nearest(str(name), self.sensors, "")
            message = f"sensor: expected one of {expected}; received {row.get(SENSOR)!r}{guess}"
            raise BadLine(message)
        sensor = self.sensors[name]
        self.say_unused(name, row)
        values = tuple([self._number(row, column) for column in sensor.columns])
        self._require_elevations(sensor, values)
        return Reading(time, values, name, self._deviations(row, sensor, values), controls)

    def _require_elevations(self, sensor: StreamSensor, values: tuple[float, ...]) -> None:
        """Raise BadLine for an elevation above a right angle, UserError before the stream had a valid one."""
        for name, value in zip(sensor.columns, values, strict=True):
            if not name.endswith(ELEVATION):
                continue
            if abs(value) > math.pi / 2:
                given = self.units.get(name, "rad"), self.scales.get(name, 1.0)
                message = steep_elevation(name, value, *given)
                raise BadLine(message) if self.levelled else UserError(message)
            self.levelled |= not math.isnan(value)

    @property
    def asks(self) -> bool:
        """Whether lines may request predictions only: JSON objects, or a header without measured values."""
        return not {*(self.names or ())} & self.measured

    def _time(self, row: dict[str, Any]) -> float:
        """Parse the time of a row; raises BadLine."""
        cells = [row[key] for key in TIME if key in row]
        cell = cells[0] if len(cells) == 1 else None
        time = number(cell, "time") if self.clock is None else self.clock.time(cell)
        if math.isnan(time):
            message = "time: expected a number; received none"
            raise BadLine(message)
        return time

    def _controls(self, row: dict[str, Any]) -> tuple[float | None, ...]:
        """Parse the controls changed by a row, None for unchanged ones; raises BadLine."""
        given = [number(row.get(name), name) for name in self.controls]
        for name, value in zip(self.controls, given, strict=True):
            if abs(value) > LARGEST:
                message = f"{name}: expected {FINITE}; received {value:g}"
                raise BadLine(message)
        if all(map(math.isnan, given)):
            return ()
        return tuple([None if math.isnan(value) else value for value in given])

    def say_unused(self, name: str, row: dict[str, Any]) -> None:
        """Warn, once per sensor and column, of values that the sensor does not use."""
        for key in self.foreign[name]:
            if key in row and (name, key) not in self.said and not is_missing(row[key]):
                self.said.add((name, key))
                ignored = "measurements: %s is ignored on lines from sensor %s, which does not measure it"
                log.warning(ignored, key, name)

    def _cells(self, text: str) -> dict[str, Any]:
        assert self.names is not None
        cells = self._split(text)
        if len(cells) != len(self.names):
            message = f"expected {len(self.names)} cells; received {len(cells)}"
            raise BadLine(message)
        return dict(zip(self.names, cells, strict=True))

    def _split(self, text: str) -> list[str]:
        """Split a line into cells; raises BadLine."""
        cells = text.split(self.delimiter)
        if '"' in text:
            try:
                cells = next(csv.reader([text], delimiter=self.delimiter, skipinitialspace=True))
            except csv.Error as error:
                message = f"expected valid cells; received: {error}"
                raise BadLine(message) from error
        return [cell.strip() for cell in cells]

    def _object(self, text: str) -> dict[str, Any]:
        try:
            row = json.loads(text, object_pairs_hook=self._row)
        except (ValueError, RecursionError) as error:
            message = f"expected a JSON object; received: {error}"
            raise BadLine(message) from error
        if not isinstance(row, dict):
            message = f"expected a JSON object; received {text[:40]!r}"
            raise BadLine(message)
        if unknown := row.keys() - self.known:
            message = f"expected {self._expected()}; received {sorted(unknown)[0]!r}"
            raise BadLine(message)
        return row

    def _row(self, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        return unique([(self._called(key), value) for key, value in pairs])

    def _called(self, name: str) -> str:
        """Return the canonical name of a column; a single control may have any of the control names."""
        name = OTHER_NAMES.get(name, name)
        if name in self.known or (ours := control_named(name, self.controls)) == name:
            return name
        if ("", name) not in self.said:
            self.said.add(("", name))
            log.info("measurements: %s is used as the control %s", name, ours)
        return ours

    def _deviations(
        self, row: dict[str, Any], sensor: StreamSensor, values: tuple[float, ...]
    ) -> tuple[float, ...] | None:
        """Parse the standard deviations of a row; None if those of the sensor apply."""
        given = [self._number(row, SD + name) for name in sensor.columns]
        if sensor.deviations is not None and all(map(math.isnan, given)):
            return None
        own = sensor.deviations or (math.nan,) * len(given)
        chosen = [other if math.isnan(sd) else sd for sd, other in zip(given, own, strict=True)]
        for k, (name, value) in enumerate(zip(sensor.columns, values, strict=True)):
            if math.isnan(value) and math.isnan(chosen[k]):
                chosen[k] = 1.0  # unused, since the value is missing
            if not chosen[k] > 0.0:
                message = f"{SD}{name}: expected a number > 0; received {row.get(SD + name)!r}"
                raise BadLine(message)
        return tuple(chosen)

    def _number(self, row: dict[str, Any], name: str) -> float:
        """Return the value of a column in the sensor's unit; raises BadLine."""
        cell, scale = row.get(name), self.scales.get(name, 1.0)
        return number(number(cell, name) * scale, name)

    def _name(self, cell: str) -> str:
        """Return the column name in a header cell; raises UserError for unknown names."""
        name, unit = column_of(cell, {*TIME, *self.measured})
        name = self._called(name)
        if name not in self.known:
            several = ". If it names the objects, set objects=id; else leave it out" if name == "id" else ""
            message = f"measurements: expected a header with {self._expected()}; received {name!r}"
            raise UserError(message + (several or nearest(name, sorted(self.known))))
        if unit is not None and name in TIME and self.clock is not None:
            self.clock = self.clock.named(unit)
        elif unit is not None and name in self.measured:
            self.scales[name], self.units[name] = self._scale(name.removeprefix(SD), unit), unit
        return name

    def _check_columns(self, named: set[str]) -> None:
        """Raise UserError for a table without standard deviations; warn of missing columns."""
        for name, sensor in self.sensors.items():
            lacking = [column for column in sensor.columns if column in named and SD + column not in named]
            if sensor.deviations is None and lacking:
                key = "measurement.sd" if self.only else f"sensors.{name}.sd"
                message = (
                    f"measurements: expected a column {SD}{lacking[0]}, or {key}=NUMBER; received neither"
                )
                raise UserError(message)
            absent = [column for column in sensor.columns if column not in named]
            if absent and len(absent) < len(sensor.columns):
                whose = "" if self.only else f" of {name}"
                log.warning(
                    "measurements: no column %s%s, so its values are missing", ", ".join(absent), whose
                )

    def _scale(self, name: str, given: str) -> float:
        """Return the unit conversion factor of a column; raises UserError for an incompatible unit."""
        units = {}
        for sensor in self.sensors.values():
            units |= dict(zip(sensor.columns, sensor.measurement.units, strict=True))
        try:
            return factor(given, units[name])
        except ValueError as error:
            message = (
                f"measurements: expected {name} in {units[name]}, or in a compatible unit; received {given}"
            )
            raise UserError(message) from error

    def _expected(self) -> str:
        names = dict.fromkeys(name for one in self.sensors.values() for name in one.columns)
        others = [self.objects] if self.objects else []
        return "time and " + ", ".join((*others, *names, *self.controls))


def _keys(sensor: StreamSensor) -> set[str]:
    """Return the column names of a sensor's values and of their standard deviations."""
    return {*sensor.columns, *(SD + name for name in sensor.columns)}

"""Tracking data messages (CCSDS 503.0-B): ranges, range rates and angles of two-way and one-way links.

The standard does not specify whether two-way ranges and rates refer to the full path or half of it; here this
is an option, by default half.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ahnn.data.files import epochs
from ahnn.data.files.table import Fault, Note, Place, refuse, within
from ahnn.tracking.formats.gathered import TrackingReading, between, gathered, measured
from ahnn.tracking.formats.instants import utc_moment
from ahnn.tracking.formats.tdm_link import TdmLink, link_of, tdm_clock
from ahnn.tracking.formats.tdm_segment import USED_DATA, WEATHER, TdmSegment, kvn_segments
from ahnn.tracking.formats.tdm_xml import xml_segments
from ahnn.tracking.formats.tracking_sidecar import TwoWay
from ahnn.tracking.tracking_data import Event, Kind, TrackingData

WEATHER_BOUNDS = {"PRESSURE": (300.0, 1200.0), "TEMPERATURE": (180.0, 340.0), "RHUMIDITY": (0.0, 105.0)}

WeatherSeries = dict[str, dict[str, list[tuple[int, float]]]]
"""Moments and values by station and keyword."""


def tdm_data(text: str, file: str, two_way: TwoWay = "half", note: Note = refuse) -> list[TrackingData]:
    """Return the measurements of a message.

    Args:
        text: text of the message, in either notation.
        file: file name.
        two_way: part of the round trip that two-way ranges and rates measure, half or whole.
        note: callback for damaged records, which are then skipped.

    Raises:
        UserError: an unreadable message, no measurement, or a fault raised by `note`.
    """
    segments = xml_segments(text, file) if text.lstrip().startswith("<") else kvn_segments(text, file)
    weather: WeatherSeries = {}
    found: dict[tuple[str, Event], list[TrackingReading]] = {}
    remarks: dict[str, None] = {}
    for segment in segments:
        _add_weather(segment, weather, note)
        if any(key in USED_DATA for _, key, _, _ in segment.records):
            link = link_of(segment, two_way)
            readings = _readings(segment, link, note)
            found.setdefault((link.satellite, link.event), []).extend(readings)
            remarks |= dict.fromkeys(link.remarks)
            if any(key == "DOPPLER_INTEGRATED" for _, key, _, _ in segment.records):
                remarks[_of_integration(readings, link.interval)] = None
    found = {key: readings for key, readings in found.items() if readings}
    unused = sorted({key for one in segments for _, key, _, _ in one.records} - {*USED_DATA, *WEATHER})
    if not found:
        received = ", ".join(unused) or "none of them"
        Place(file).refuse("ranges, Doppler or angles in a tracking data message (TDM)", received)
    said = (*((f"not used: {', '.join(unused)}",) if unused else ()), *remarks)
    return [
        gathered(satellite, _with_weather(readings, weather), event, said)
        for (satellite, event), readings in found.items()
    ]


def _readings(segment: TdmSegment, link: TdmLink, note: Note) -> list[TrackingReading]:
    """Return the measurements of a segment, combined by moment."""
    found: dict[int, TrackingReading] = {}
    for row, key, epoch, text in segment.records:
        if key not in USED_DATA:
            continue
        place = Place(segment.place.file, row, key)
        try:
            moment = utc_moment(epoch, place, link.clock)
            kind, value = _value(key, text, link, place)
            if key == "DOPPLER_INTEGRATED":
                moment += round(link.middle * epochs.SECOND)
            one = found.setdefault(moment, TrackingReading(moment, link.station, {}, row))
            if kind in one.values:
                place.refuse("each keyword once per epoch", f"{epoch}, which duplicates row {one.row}")
            one.values[kind] = value
        except Fault as fault:
            note(fault)
    return [one for one in found.values() if one.values]


def _value(key: str, text: str, link: TdmLink, place: Place) -> tuple[Kind, float]:
    """Return the kind of a measurement and its value in km, km/s or rad; raises UserError."""
    if key in ("ANGLE_1", "ANGLE_2"):
        kind, factor = link.angle(key, place), math.pi / 180
    elif key == "RANGE":
        kind, factor = "range", link.range_factor(place)
    else:
        kind, factor = "range_rate", link.rate_factor(key, place)
    return kind, measured(kind, text, factor, place, link.corrections.get(key, 0.0))


def _of_integration(readings: list[TrackingReading], interval: float) -> str:
    """Return a remark on integrated Doppler, with the deviation of a mean from the rate at its midpoint.

    To leading order, the deviation is the squared interval times the second derivative of the rate over 24;
    the largest divided difference of three successive measurements is used as this derivative.
    """
    what = f"means over {interval:g} s are treated as the range rates at their midpoints"
    ranked = sorted((one.moment, one.values["range_rate"]) for one in readings if "range_rate" in one.values)
    times = np.array([(moment - ranked[0][0]) / epochs.SECOND for moment, _ in ranked])
    if len(times) < 3:
        return what
    slopes = np.diff([value for _, value in ranked]) / np.diff(times)
    bends = 2 * np.diff(slopes) / (times[2:] - times[:-2])
    return f"{what}, with an error of up to about {1e6 * interval**2 / 24 * np.abs(bends).max():.2g} mm/s"


def _add_weather(segment: TdmSegment, weather: WeatherSeries, note: Note) -> None:
    """Add the weather of a segment to the series of its station."""
    for row, key, epoch, text in segment.records:
        if key in WEATHER:
            place = Place(segment.place.file, row, key)
            try:
                moment = utc_moment(epoch, place, tdm_clock(segment))
                value = within(text, place, *WEATHER_BOUNDS[key])
            except Fault as fault:
                note(fault)
            else:
                series = weather.setdefault(station_of(segment), {})
                series.setdefault(key, []).append((moment, value))


def station_of(segment: TdmSegment) -> str:
    """Return the station of a segment's weather: the last participant of the path, or else the first one."""
    last = segment.meta.get("PATH", "1").split(",")[-1].strip()
    return segment.meta.get(f"PARTICIPANT_{last}", segment.meta.get("PARTICIPANT_1", ""))


def _with_weather(readings: list[TrackingReading], weather: WeatherSeries) -> list[TrackingReading]:
    """Return measurements with the weather of their stations, linearly interpolated."""
    found = {}
    for station in {one.station for one in readings}:
        mine = [one.moment for one in readings if one.station == station]
        series = weather.get(station, {})
        columns = [_at(series.get(key, []), mine) for key in WEATHER]
        found[station] = iter(zip(*columns, strict=True))
    return [
        replace(one, weather=(pressure, temperature, min(humidity / 100, 1.0)))
        for one in readings
        for pressure, temperature, humidity in [next(found[one.station])]
    ]


def _at(series: list[tuple[int, float]], moments: list[int]) -> list[float]:
    """Interpolate values at moments; NaN without values."""
    if not series:
        return [math.nan] * len(moments)
    known, values = zip(*series, strict=True)
    return between(list(known), list(values), moments)

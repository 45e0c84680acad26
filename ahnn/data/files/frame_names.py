"""Canonical names of frames, centres and time scales."""

from __future__ import annotations

import re

from ahnn.data.files.epochs import instant, spelled

INERTIAL = ("GCRF", "EME2000")
NAMES = {
    **{"GCRF": "GCRF", "ICRF": "GCRF", "EME2000": "EME2000", "J2000": "EME2000"},
    **{"TEME": "TEME", "CIRS": "CIRS"},
}
OF_DATE = ("TEME", "CIRS")
"""Frames whose axes move; `CIRS of 2026-03-01T00:00:00` has its axes of that moment at all times."""
FIXED_AT = " of "
"""Separates the name of such a frame and the moment."""
CENTRES = ("EARTH", "SUN", "MOON", "MARS", "VENUS", "JUPITER", "SATURN")
SPELLINGS = {
    **{frame: frame for frame in ("EME2000", "GCRF", "ICRF", "TEME", "CIRS")},
    **{"J2000": "EME2000", "TEMEOFDATE": "TEME"},
    **{centre: centre for centre in CENTRES},
    **{clock: clock for clock in ("UTC", "TAI", "GPS", "TT", "TDB")},
}
"""Canonical name for each capitalised synonym of frames, centres and time scales."""
SIDECAR = "Set it with the key frame in a sidecar"
LISTED = ", ".join((*NAMES, "ITRF"))
"""Frames that can be converted, for messages."""
ROTATING = ("ITRF", "ECEF", "EFG", "GTOD", "GRC", "TDR", "WGS")
"""Prefixes of the names of Earth-fixed frames."""


def canonical(frame: str) -> str:
    """Return the canonical frame, centre and time scale: EME2000, EARTH, UTC for `J2000, Earth, utc`."""
    words = [re.sub(r"(?i)^itrf[-_ ]?(?=\d|$)", "ITRF", " ".join(word.split())) for word in frame.split(",")]
    return ", ".join(SPELLINGS.get(word.upper(), word) for word in words)


def known(frame: str) -> str:
    """Return the frame of a name such as `ITRF2014, EARTH, UTC`; "" if unknown."""
    given, of, moment = frame.split(",")[0].strip().partition(FIXED_AT)
    name = given.upper()
    if of:
        date = _spelled(moment) if NAMES.get(name) in OF_DATE else ""
        return f"{NAMES[name]}{of}{date}" if date else ""
    return "ITRF" if name.startswith("ITRF") and " " not in name else NAMES.get(name, "")


def is_unknown(frame: str) -> bool:
    """Return whether a name is stated, and is neither a frame that can be converted nor Earth-fixed."""
    return bool(frame) and not known(frame) and not frame.upper().startswith(ROTATING)


def _spelled(moment: str) -> str:
    """Return an epoch of UTC in its usual format; "" for other text."""
    try:
        return spelled(instant(moment, utc=True), utc=True)
    except ValueError:
        return ""


def remedy(*given: str) -> str:
    """Return a remedy for different frames: an option if they can be transformed, else manual conversion."""
    turnable = len({frame.split(",")[0] for frame in given}) > 1 and all(map(known, given))
    return "system.frame=GCRF converts all of them" if turnable else "Convert one of them"

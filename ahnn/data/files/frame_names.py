"""Canonical names of frames, centres and time scales."""

from __future__ import annotations

import re

INERTIAL = ("GCRF", "EME2000")
NAMES = {
    **{"GCRF": "GCRF", "ICRF": "GCRF", "EME2000": "EME2000", "J2000": "EME2000"},
    **{"TEME": "TEME", "CIRS": "CIRS"},
}
CENTRES = ("EARTH", "SUN", "MOON", "MARS", "VENUS", "JUPITER", "SATURN")
SPELLINGS = {
    **{frame: frame for frame in ("EME2000", "GCRF", "ICRF", "TEME", "CIRS")},
    **{"J2000": "EME2000", "TEMEOFDATE": "TEME"},
    **{centre: centre for centre in CENTRES},
    **{clock: clock for clock in ("UTC", "TAI", "GPS", "TT", "TDB")},
}
"""Canonical name for each capitalised synonym of frames, centres and time scales."""
SIDECAR = "Set it with the key frame in a sidecar"
ROTATING = ("ITRF", "ECEF", "EFG", "GTOD", "GRC", "TDR", "WGS")
"""Prefixes of the names of Earth-fixed frames."""


def canonical(frame: str) -> str:
    """Return the canonical frame, centre and time scale: EME2000, EARTH, UTC for `J2000, Earth, utc`."""
    words = [re.sub(r"(?i)^itrf[-_ ]?(?=\d|$)", "ITRF", " ".join(word.split())) for word in frame.split(",")]
    return ", ".join(SPELLINGS.get(word.upper(), word) for word in words)


def known(frame: str) -> str:
    """Return the frame of a name such as `ITRF2014, EARTH, UTC`; "" if unknown."""
    name = frame.split(",")[0].strip().upper()
    return "ITRF" if name.startswith("ITRF") and " " not in name else NAMES.get(name, "")


def remedy(*given: str) -> str:
    """Return a remedy for different frames: an option if they can be transformed, else manual conversion."""
    turnable = len({frame.split(",")[0] for frame in given}) > 1 and all(map(known, given))
    return "system.frame=GCRF converts all of them" if turnable else "Convert one of them"

"""Names of frames, centres and time systems, however they are spelled."""

from __future__ import annotations

import re

INERTIAL = ("GCRF", "EME2000")
NAMES = {"GCRF": "GCRF", "ICRF": "GCRF", "EME2000": "EME2000", "J2000": "EME2000", "TEME": "TEME"}
CENTRES = ("EARTH", "SUN", "MOON", "MARS", "VENUS", "JUPITER", "SATURN")
SPELLINGS = {
    **{frame: frame for frame in ("EME2000", "GCRF", "ICRF", "TEME")},
    **{"J2000": "EME2000", "TEMEOFDATE": "TEME"},
    **{centre: centre for centre in CENTRES},
    **{clock: clock for clock in ("UTC", "TAI", "GPS", "TT", "TDB")},
}
"""From words of frames, centres and clocks in capitals to the word for all that mean the same."""
SIDECAR = "The key frame of a sidecar says it"
ROTATING = ("ITRF", "ECEF", "EFG", "GTOD", "GRC", "TDR", "WGS")
"""How the names of frames begin that turn with the Earth."""


def canonical(frame: str) -> str:
    """Return the one spelling of a frame, centre and clock: EME2000, EARTH, UTC for `J2000, Earth, utc`."""
    words = [re.sub(r"(?i)^itrf[-_ ]?(?=\d|$)", "ITRF", " ".join(word.split())) for word in frame.split(",")]
    return ", ".join(SPELLINGS.get(word.upper(), word) for word in words)


def known(frame: str) -> str:
    """Return the frame that a name such as `ITRF2014, EARTH, UTC` means; "" for one that is not known."""
    name = frame.split(",")[0].strip().upper()
    return "ITRF" if name.startswith("ITRF") and " " not in name else NAMES.get(name, "")


def remedy(*given: str) -> str:
    """Return what makes one frame of several: another key where they can be turned, or work."""
    turnable = len({frame.split(",")[0] for frame in given}) > 1 and all(map(known, given))
    return "system.frame=GCRF turns all into one" if turnable else "Convert one of them"

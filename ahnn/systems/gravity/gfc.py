"""Reading of gravity fields in ICGEM format (.gfc).

Barthelmes & Förste, The ICGEM-format, GFZ Potsdam 2011. Time-variable coefficients (rows gfct) are evaluated
at an epoch: C(t) = C(t0) + trnd s + sum of acos cos(2 pi s / T) + asin sin(2 pi s / T), s = t - t0 in years.
Version 2.0 is supported for static fields.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from math import perm, pi, sqrt
from pathlib import Path
from typing import Any, get_args

import numpy as np

from ahnn.contents import read_whole
from ahnn.systems.gravity.field import GravityField, Tide
from ahnn.systems.gravity.harmonics import Coefficients
from ahnn.systems.gravity.rows import VARIES, Coefficient, CoefficientLine, Index, coefficients

log = logging.getLogger(__name__)

MU, RADIUS, DEGREE = "earth_gravity_constant", "radius", "max_degree"
KNOWN: dict[str, tuple[str, ...]] = {
    "product_type": ("gravity_field",),
    "norm": ("fully_normalized", "unnormalized"),
    "tide_system": get_args(Tide),
    "format": ("icgem1.0", "icgem2.0"),
}
"""Supported values of header keywords; the first is the default."""
LARGEST = 500_000_000
"""Maximum file size in bytes; a field to degree 2190 has 250 million."""
PLAIN = 80
"""Degree above which normalisation factors overflow."""
NEWTON = 6.6743e-11
"""Newton's constant, m^3/(kg s^2)."""
DENSITIES, STONES, SMALL = (10.0, 1e5), 4500.0, 1e5
"""Limits of the mean density in kg/m^3, its maximum for small bodies, and their maximum radius in m."""
MASS, OFFSET = 1e-4, 1e-6
"""Tolerances of C_00 and of the coefficients of degree 1; the latter is 11 m on the Earth."""
CONVENTION: dict[Index, Coefficient] = {(0, 0): (1.0, 0.0), (1, 0): (0.0, 0.0), (1, 1): (0.0, 0.0)}
"""Coefficients that may be omitted: mu includes the entire mass, and the origin is the centre of mass."""


def read_gfc(path: Path | str, epoch: str | None = None) -> GravityField:
    """Read the gravity field in a file, in km and s.

    Args:
        path: path of the file.
        epoch: epoch of time-variable coefficients, YYYY-MM-DD.

    Raises:
        UserError: the file is missing or invalid; the message names the row.
    """
    file = CoefficientLine(str(path), 0, [])
    try:
        text = read_whole(Path(path), LARGEST).decode("latin-1")
    except OSError as error:
        file.refuse("a file with a gravity field", error.strerror)
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    numbered = (
        CoefficientLine(str(path), row, words.split()) for row, words in enumerate(text.split("\n"), 1)
    )
    lines = [line for line in numbered if line.words]
    ends = [k for k, line in enumerate(lines) if line.word(0) == "end_of_head"]
    if not ends:
        file.refuse("a header that ends with end_of_head, as in ICGEM files", "none")
    head = header(lines[: ends[0]], file)
    rows = lines[ends[0] + 1 :]
    for line in rows:
        if line.word(0) == VARIES and head.get("format", line).word(1) == "icgem2.0":
            line.refuse(
                "a static field in icgem2.0 format, or icgem1.0 format", f"a {VARIES} row with intervals"
            )
    degree = head[DEGREE].whole(1, DEGREE)
    found = CONVENTION | coefficients(rows, degree, epoch)
    require_all(found, degree, file)
    return assembled(found, degree, head, file)


def header(lines: list[CoefficientLine], file: CoefficientLine) -> dict[str, CoefficientLine]:
    """Return header lines by keyword; text before begin_of_head is a comment.

    Raises:
        UserError: a keyword is missing or duplicate, or has an invalid value.
    """
    starts = [k for k, line in enumerate(lines) if line.word(0) == "begin_of_head"]
    head: dict[str, CoefficientLine] = {}
    for line in lines[starts[0] + 1 if starts else 0 :]:
        name = MU if line.word(0) == "gravity_constant" else line.word(0)  # the name for other bodies
        if name not in (MU, RADIUS, DEGREE, "modelname", *KNOWN):
            continue
        if len(line.words) < 2 or name in head:
            line.refuse(f"one {name} with a value", " ".join(line.words)[:60])
        if name in KNOWN and line.word(1) not in KNOWN[name]:
            line.refuse(f"{name} {' or '.join(KNOWN[name])}", line.word(1))
        head[name] = line
    for name in (MU, RADIUS, DEGREE):
        if name not in head:
            file.refuse(f"{name} in the header", "none")
    return head


def require_all(found: Mapping[Index, Any], degree: int, file: CoefficientLine) -> None:
    """Raise UserError for a file without all coefficients up to its degree."""
    if sum(n <= degree for n, _ in found) == (degree + 1) * (degree + 2) // 2:
        return
    pairs = ((n, m) for n in range(degree + 1) for m in range(n + 1))
    missing = next(pair for pair in pairs if pair not in found)
    file.refuse(
        f"all coefficients to {DEGREE} {degree}", f"none for n, m = {missing}; the file may be cut off"
    )


def assembled(
    found: Mapping[Index, Coefficient],
    degree: int,
    head: Mapping[str, CoefficientLine],
    file: CoefficientLine,
) -> GravityField:
    """Build the field from coefficients and a header.

    Raises:
        UserError: an invalid mu or radius, or coefficients that overflow.
    """
    mu, radius = head[MU].number(1, MU), head[RADIUS].number(1, RADIUS)
    plain = head.get("norm", file).word(1) == "unnormalized"
    if plain and degree > PLAIN:
        head["norm"].refuse(f"norm fully_normalized above degree {PLAIN}", f"unnormalized to degree {degree}")
    for name, value in ((MU, mu), (RADIUS, radius)):
        if value <= 0:
            head[name].refuse(f"{name} > 0, in m and s", value)
    require_body(mu, radius, head)
    factor = inverse_normalisation if plain else one
    cosines, sines = np.zeros((2, degree + 1, degree + 1))
    for (n, m), pair in found.items():
        if n <= degree:
            cosines[n, m], sines[n, m] = (value * factor(n, m) for value in pair)
    if not (np.isfinite(cosines).all() and np.isfinite(sines).all()):
        file.refuse("coefficients that are finite when normalised", "infinite ones")
    require_centred(cosines, sines, file)
    name = head["modelname"].word(1) if "modelname" in head else Path(file.file).stem
    tide: Any = head["tide_system"].word(1) if "tide_system" in head else "unknown"
    return GravityField(name, mu / 1e9, radius / 1e3, cosines, sines, tide)


def require_body(mu: float, radius: float, head: Mapping[str, CoefficientLine]) -> None:
    """Raise UserError for an impossible mass and radius, for example with numbers in km."""
    with np.errstate(over="ignore"):  # absurd values must not warn
        density = np.float64(mu) / (4 / 3 * pi * NEWTON * np.float64(radius) ** 3)
    low, high = DENSITIES
    if not low <= density <= (STONES if radius < SMALL else high):
        head[RADIUS].refuse(
            f"{RADIUS} in m and {MU} in m^3/s^2 that give a density of {low:g} to {high:g} kg/m^3, or at "
            "most "
            f"{STONES:g} if {RADIUS} is below {SMALL / 1e3:g} km",
            f"{radius:g} and {mu:g}, which give {density:.3g} kg/m^3. Write both in metres",
        )
    if radius < SMALL:
        log.warning(
            "%s: the body has a radius of %g m; values are assumed to be in m and s",
            head[RADIUS].file,
            radius,
        )


def require_centred(cosines: Coefficients, sines: Coefficients, file: CoefficientLine) -> None:
    """Raise UserError for coefficients that do not refer to the body's centre of mass."""
    if abs(cosines[0, 0] - 1) > MASS:
        file.refuse("C = 1 for n, m = (0, 0), since GM includes the entire mass", f"{cosines[0, 0]:g}")
    first = max(abs(cosines[1, :2]).max(), abs(sines[1, 1]))
    if first > OFFSET:
        said = f"degree-1 coefficients of up to {first:g}. Shift the origin, or leave these rows out"
        file.refuse(f"the origin at the centre of mass, with C10, C11 and S11 within {OFFSET:g} of 0", said)
    if (most := max(abs(cosines).max(), abs(sines).max())) > 1 + MASS:
        file.refuse("normalised coefficients of at most 1", f"one of {most:g}")


def one(n: int, m: int) -> float:
    """Return the factor 1, for coefficients that are already normalised."""
    del n, m
    return 1.0


def inverse_normalisation(n: int, m: int) -> float:
    """Return 1 / sqrt((2 - [m = 0]) (2 n + 1) (n - m)! / (n + m)!), the normalisation of a coefficient."""
    return sqrt(perm(n + m, 2 * m) / ((1 if m == 0 else 2) * (2 * n + 1)))

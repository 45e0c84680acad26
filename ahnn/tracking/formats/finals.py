"""Daily Earth orientation from the package astropy-iers-data: finals2000A of the IERS.

Columns are defined in the IERS's readme.finals2000A: modified Julian date, x and y of the pole in arcseconds,
UT1 - UTC in seconds and offsets dX, dY of the celestial pole in mas, all from Bulletin A.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ahnn.data.files.raw import content_of, decoded
from ahnn.data.files.table import Place, number
from ahnn.optional_libraries import library
from ahnn.tracking.formats.bulletin_b import EarthOrientation

COLUMNS = {
    "MJD": (7, 15),
    "x": (18, 27),
    "y": (37, 46),
    "UT1-UTC": (58, 68),
    "dX": (97, 106),
    "dY": (116, 125),
}
"""Column positions of each number."""
PREDICTED = 57
"""Column where P marks a predicted UT1."""


def installed_orientation() -> EarthOrientation:
    """Load the daily values of the package astropy-iers-data.

    Raises:
        UserError: the package is not installed, or its file is damaged.
    """
    data = library("astropy_iers_data", "astropy-iers-data", "orbit", "orientation of the Earth")
    path = Path(data.IERS_A_FILE)
    return finals_orientation(decoded(content_of(path), path), str(path))


def finals_orientation(text: str, file: str) -> EarthOrientation:
    """Return the days of a finals2000A file that have UT1; missing pole offsets are 0.

    Raises:
        UserError: an invalid number, with its line number.
    """
    rows = []
    for row, line in enumerate(text.split("\n"), 1):
        cells = {name: line[first:last].strip() for name, (first, last) in COLUMNS.items()}
        if cells["UT1-UTC"]:
            place = Place(file, row)
            rows.append([number(cell or "0", place._replace(column=name)) for name, cell in cells.items()])
            rows[-1].append(float(line[PREDICTED] != "P"))
    if not rows:
        Place(file).refuse("days with UT1-UTC, as in finals2000A", "none")
    table = np.array(rows)
    mjd, x, y, ut1 = table[:, :4].T
    return EarthOrientation(mjd, x, y, ut1, table[:, 4:6] / 1000, table[:, 6] > 0)

"""All of the tests on all of the files, in one pass."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ahnn.data.doctor.finding import Finding
from ahnn.data.doctor.leakage import leakage_findings
from ahnn.data.doctor.orbits import orbit_findings
from ahnn.data.doctor.samples import sample_findings, too_few
from ahnn.data.doctor.velocities import velocity_findings
from ahnn.data.files.content import Content, since_first
from ahnn.data.files.reading import FileReading, bytes_of, parsed
from ahnn.data.files.table import Fault, Place, Remark

JUDGED = 200
"""Trajectories of a file, evenly spread, whose units and frame are judged."""
KINDS = ("positions", "rates", "momenta", "units", "frame")
"""What files that are read together share."""


class Examined(NamedTuple):
    """What was found.

    Attributes:
        findings: in the order of the files, faults of reading first.
        contents: of the files that could be read at all.
    """

    findings: list[Finding]
    contents: list[Content]

    @property
    def faults(self) -> list[Finding]:
        """What would spoil a training."""
        return [finding for finding in self.findings if finding.level == "fault"]


def examine(
    paths: Sequence[Path],
    reading: FileReading,
    mass: float | Sequence[float] | None = None,
    gap: float = 10.0,
) -> Examined:
    """Return all that is wrong with files.

    Args:
        paths: of the files.
        reading: how they are read.
        mass: factor m of p = m dq/dt.
        gap: a step so many times longer than the median is one.

    Raises:
        UserError: there is no such file.
    """
    said: list[Fault | Remark] = []
    contents: list[Content] = []
    for path in paths:
        raw, aside = bytes_of(path)
        try:
            contents.append(parsed(path, raw, aside, reading, said.append))
        except Fault as fault:
            said.append(fault)
    contents = [content for content in contents if any(len(track.times) for track in content.tracks)]
    contents = since_first(contents)
    found = [Finding.of(one) for one in said]
    known = {(one.file, one.row, one.column) for one in found if one.level == "fault"}
    later = [one for one in diagnosis(contents, mass, gap) if (one.file, one.row, one.column) not in known]
    return Examined(found + later, contents)


def diagnosis(contents: Sequence[Content], mass: float | Sequence[float] | None, gap: float) -> list[Finding]:
    """Return what is wrong with the content of files that could be read.

    Args:
        contents: of the files.
        mass: factor m of p = m dq/dt; None where nobody said.
        gap: a step so many times longer than the median is one.
    """
    found: list[Finding] = list(too_few(contents))
    for content in contents:
        file = content.tracks[0].file
        whole = content._replace(tracks=tuple(track for track in content.tracks if len(track.times)))
        judged = list(whole.tracks[:: -(-len(whole.tracks) // JUDGED)])
        found += sample_findings(whole, gap)
        if content.momenta and mass is None:
            what, remedy = "momenta of a mass that nobody states", "system.mass=..., in kg"
            found.append(Finding("fault", file, content.head, content.rates[0], what, remedy))
        else:
            found += velocity_findings(whole, judged, mass or 1.0)
        found += orbit_findings(whole, judged)
        found += clash(contents[0], content)
    return found + leakage_findings([track for content in contents for track in content.tracks])


def clash(first: Content, other: Content) -> list[Finding]:
    """Return in what a file differs from the first, with which it would be read."""
    wrong = [name for name in KINDS if getattr(first, name) != getattr(other, name)]
    expected = f"the {', '.join(wrong)} of {first.tracks[0].file}"
    place = Place(other.tracks[0].file, other.head)
    return [Finding.of(Fault(place, expected, "others", "Read it by itself"))] if wrong else []

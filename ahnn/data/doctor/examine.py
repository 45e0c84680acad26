"""Application of all tests to all files, in one pass."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ahnn.data.doctor.finding import Finding, is_consequence
from ahnn.data.doctor.leakage import leakage_findings
from ahnn.data.doctor.orbits import orbit_findings
from ahnn.data.doctor.samples import sample_findings, too_few
from ahnn.data.doctor.velocities import velocity_findings
from ahnn.data.files.content import CANONICAL, Content, since_first
from ahnn.data.files.reading import FileReading, bytes_of, parsed
from ahnn.data.files.table import Fault, Place, Remark

JUDGED = 200
"""Number of evenly spread trajectories of a file whose units and frame are tested."""
KINDS = ("positions", "rates", "momenta", "units", "frame")
"""Properties shared by files that are read together."""


class Examined(NamedTuple):
    """Result of an examination.

    Attributes:
        findings: findings in the order of the files, read errors first.
        contents: contents of the readable files.
    """

    findings: list[Finding]
    contents: list[Content]

    @property
    def faults(self) -> list[Finding]:
        """Findings that would spoil the training."""
        return [finding for finding in self.findings if finding.level == "fault"]


def examine(
    paths: Sequence[Path],
    reading: FileReading,
    mass: float | Sequence[float] | str | None = None,
    gap: float = 10.0,
) -> Examined:
    """Find all defects of files.

    Args:
        paths: paths of the files.
        reading: reading options.
        mass: factor m of p = m dq/dt, or `canonical`.
        gap: multiple of the median step that counts as a gap.

    Raises:
        UserError: a file is missing.
    """
    said: list[Fault | Remark] = []
    contents: list[Content] = []
    for path in paths:
        raw, aside = bytes_of(path)
        try:
            contents.append(parsed(path, raw, aside, reading, said.append))
        except Fault as fault:
            if not is_consequence(fault, said):
                said.append(fault)
    contents = [content for content in contents if any(len(track.times) for track in content.tracks)]
    contents = since_first(contents)
    found = [Finding.of(one) for one in said]
    known = {(one.file, one.row, one.column) for one in found if one.level == "fault"}
    later = [one for one in diagnosis(contents, mass, gap) if (one.file, one.row, one.column) not in known]
    return Examined(found + later, contents)


def diagnosis(
    contents: Sequence[Content], mass: float | Sequence[float] | str | None, gap: float
) -> list[Finding]:
    """Find the defects in the content of readable files.

    Args:
        contents: contents of the files.
        mass: factor m of p = m dq/dt; None if unspecified, `canonical` for momenta without one.
        gap: multiple of the median step that counts as a gap.
    """
    found: list[Finding] = list(too_few(contents))
    for content in contents:
        file = content.tracks[0].file
        whole = content._replace(tracks=tuple(track for track in content.tracks if len(track.times)))
        judged = list(whole.tracks[:: -(-len(whole.tracks) // JUDGED)])
        found += sample_findings(whole, gap)
        stated = CANONICAL if content.general and mass is None else mass
        if content.momenta and stated is None:
            what = "momenta without a stated mass"
            remedy = f"mass=..., in kg, or mass={CANONICAL}; system.mass= in a training"
            found.append(Finding("fault", file, content.head, content.rates[0], what, remedy))
        elif not isinstance(stated, str):
            found += velocity_findings(whole, judged, stated or 1.0)
        found += orbit_findings(whole, judged)
        found += clash(contents[0], content)
    return found + leakage_findings([track for content in contents for track in content.tracks])


def clash(first: Content, other: Content) -> list[Finding]:
    """Describe how a file differs from the first one, together with which it would be read."""
    wrong = [name for name in KINDS if getattr(first, name) != getattr(other, name)]
    expected = f"the same {' and '.join(wrong)} as in {first.tracks[0].file}"
    place = Place(other.tracks[0].file, other.head)
    return [Finding.of(Fault(place, expected, "different ones", "Read it separately"))] if wrong else []

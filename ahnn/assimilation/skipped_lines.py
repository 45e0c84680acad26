"""Report of invalid lines of a stream: the first ones of each kind, and the number of the others."""

from __future__ import annotations

import logging
from collections import Counter

log = logging.getLogger("ahnn")

SAID = 5
"""Maximum number of lines of each kind that are reported individually."""


class SkippedLines:
    """Reported lines, by what was expected of them."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.last: dict[str, int] = {}

    def add(self, line: int, error: Exception) -> None:
        """Report a line, or count it after others of its kind."""
        kind = str(error).partition("; received")[0]
        self.counts[kind] += 1
        self.last[kind] = line
        if self.counts[kind] <= SAID:
            log.info("line %d: %s; skipped", line, error)

    def conclude(self) -> None:
        """Report the numbers of the other lines."""
        for kind, count in self.counts.items():
            if count > SAID:
                more = f"{count - SAID:,} more {'line' if count == SAID + 1 else 'lines'}"
                log.info("%s skipped, up to line %d: %s", more, self.last[kind], kind)

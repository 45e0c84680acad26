"""Parsing of CCSDS messages in XML (CCSDS 505.0-B), element by element."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Generic, TypeVar
from xml.parsers import expat

from ahnn.data.files.table import Place

Found = TypeVar("Found")


class CcsdsXml(ABC, Generic[Found]):
    """Parser whose subclasses collect content at the start and end of each element.

    Attributes:
        file: file name.
        found: messages or segments in order.
        path: tags of the elements around the one that `start` or `end` receives.
        attributes: its attributes.
    """

    def __init__(self, file: str) -> None:
        self.file, self.found, self.path = file, list[Found](), list[str]()
        self.attributes: dict[str, str] = {}
        self._open: list[tuple[dict[str, str], list[str]]] = []
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler, self._parser.EndElementHandler = self._begin, self._close
        self._parser.CharacterDataHandler, self._parser.EntityDeclHandler = self._more, self._entity

    def parse(self, text: str, expected: str) -> list[Found]:
        """Return the content of a text; raises UserError unless it is XML with the `expected` message."""
        try:
            self._parser.Parse(text.encode(), True)
        except expat.ExpatError as error:
            Place(self.file, error.lineno).refuse("XML", expat.ErrorString(error.code))
        return self.found or Place(self.file).refuse(expected, "none")

    @property
    def place(self) -> Place:
        """Current place of the parser."""
        return Place(self.file, self._parser.CurrentLineNumber)

    @abstractmethod
    def start(self, tag: str) -> None:
        """Begin an element; raises UserError for one that does not belong here."""

    @abstractmethod
    def end(self, tag: str, text: str) -> None:
        """End an element with its own text."""

    def _begin(self, name: str, attributes: dict[str, str]) -> None:
        tag = name.rpartition(":")[2]
        self.attributes = attributes
        self.start(tag)
        self.path.append(tag)
        self._open.append((attributes, []))

    def _close(self, _: str) -> None:
        self.attributes, texts = self._open.pop()
        self.end(self.path.pop(), "".join(texts).strip())

    def _more(self, text: str) -> None:
        self._open[-1][1].append(text)

    def _entity(self, *_: object) -> None:
        """Reject entities, which could expand a small file to a huge one."""
        self.place.refuse("no custom entities", "one")

"""CCSDS orbit ephemeris messages in XML (CCSDS 505.0-B) as the same blocks as in keyword = value notation."""

from __future__ import annotations

from xml.parsers import expat

from ahnn.data.files.ephemeris import COMPONENTS, Block
from ahnn.data.files.table import Place

TRIANGLE = [f"C{a}_{b}" for k, a in enumerate(COMPONENTS) for b in COMPONENTS[: k + 1]]


def blocks_of(text: str, file: str) -> list[Block]:
    """Return the segments of a message as text.

    Raises:
        UserError: no XML, other units, or a state without all components.
    """
    reader = _Reader(file)
    try:
        reader.parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        Place(file, error.lineno).refuse("XML", expat.ErrorString(error.code))
    if not reader.blocks:
        Place(file).refuse("an orbit ephemeris message <oem> with a <segment>", "none")
    return reader.blocks


class _Reader:
    """Handlers that collect the texts of elements, and hand them over where a group of them ends."""

    def __init__(self, file: str) -> None:
        self.file, self.blocks, self.text = file, list[Block](), ""
        self.texts: dict[str, str] = {}
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.CharacterDataHandler = self.more
        self.parser.EntityDeclHandler = self.entity
        self.row = 0

    @property
    def place(self) -> Place:
        """Where the parser is."""
        return Place(self.file, self.parser.CurrentLineNumber)

    @property
    def block(self) -> Block:
        """The segment that the parser is in; raises UserError outside of any."""
        return self.blocks[-1] if self.blocks else self.place.refuse("a <segment> around it", "none")

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        """Begin an element."""
        self.text = ""
        wanted = "km/s" if tag.endswith("_DOT") else "km"
        if tag in COMPONENTS and attributes.get("units", wanted) != wanted:
            self.place._replace(column=tag).refuse(f"units {wanted}", repr(attributes["units"]))
        if tag == "segment":
            self.blocks.append(Block(self.place))
        if tag in ("metadata", "stateVector", "covarianceMatrix"):
            self.texts, self.row = {}, self.parser.CurrentLineNumber

    def more(self, text: str) -> None:
        """Add to the text of an element."""
        self.text += text

    def entity(self, *_: object) -> None:
        """Refuse what could make a small file a huge one."""
        self.place.refuse("no entities of its own", "one")

    def end(self, tag: str) -> None:
        """End an element: a text, or a group of them."""
        if tag == "metadata":
            self.block.meta |= self.texts
        elif tag == "stateVector":
            self.block.vectors.append((self.row, self.taken(("EPOCH", *COMPONENTS))))
        elif tag == "covarianceMatrix":
            epoch, *cells = self.taken(("EPOCH", *TRIANGLE))
            self.block.matrices.append((self.row, epoch, self.texts.get("COV_REF_FRAME", ""), cells))
        else:
            self.texts[tag] = self.text.strip()

    def taken(self, names: tuple[str, ...]) -> list[str]:
        """Return the texts of some elements; raises UserError where one is missing."""
        for name in names:
            if name not in self.texts:
                Place(self.file, self.row, name).refuse("the element", "none")
        return [self.texts[name] for name in names]

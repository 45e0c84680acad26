"""Parquet input in constant memory, and output as a folder whose last parts can be removed."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ahnn.data.files.parquet import cells
from ahnn.data.files.table import Place
from ahnn.errors import UserError
from ahnn.files import write_atomically
from ahnn.manifest import digest_of, is_own, remove_own
from ahnn.optional_libraries import library

PIECE = 1 << 20
PART = "part-{:06d}.parquet"
NAMED = re.compile(r"part-(\d{6})\.parquet")


class ParquetRows:
    """Rows of a Parquet file, analogous to `Lines` for text.

    Args:
        path: path of the file.

    Attributes:
        number: number of the last row, from 1.
        place: always 0.
        digest: hash of the file, which must not change.
        header: column names with units, as in a table.

    Raises:
        UserError: not a Parquet file, or pyarrow is not installed.
    """

    def __init__(self, path: str) -> None:
        self.arrow = library("pyarrow", "pyarrow", "parquet", path)
        reader = library("pyarrow.parquet", "pyarrow", "parquet", path)
        self.path, self.number, self.place, self._skipped = path, 0, 0, 0
        digest = hashlib.blake2b(digest_size=16)
        with open(path, "rb") as file:
            while piece := file.read(PIECE):
                digest.update(piece)
        self.digest = digest.hexdigest()
        try:
            self.file: Any = reader.ParquetFile(path)
        except (self.arrow.ArrowInvalid, OSError) as error:
            Place(path).refuse("a Parquet file", " ".join(str(error).split()))
        schema = self.file.schema_arrow
        said = [(field.metadata or {}).get(b"unit", b"").decode() for field in schema]
        names = [name + (f" [{unit}]" if unit else "") for name, unit in zip(schema.names, said, strict=True)]
        self.header = ",".join(names)

    def batches(self, count: int) -> Iterator[tuple[list[int], list[Any]]]:
        """Yield row numbers and columns of batches of limited size."""
        for batch in self.file.iter_batches(batch_size=count):
            left, self._skipped = max(0, self._skipped - batch.num_rows), min(self._skipped, batch.num_rows)
            own, self._skipped = batch.slice(self._skipped), left
            if not own.num_rows:
                continue
            first, self.number = self.number + 1, self.number + own.num_rows
            columns = [
                cells(self.arrow, own.column(k), Place(self.path, 0, name))
                for k, name in enumerate(own.schema.names)
            ]
            yield list(range(first, self.number + 1)), columns

    def begin(self) -> None:
        """Start at the first row."""

    def resume(self, number: int, place: int, digest: str) -> None:
        """Resume after a row; raises UserError if the file has changed."""
        if digest != self.digest:
            message = (
                f"measurements: expected the file whose {number} rows were processed before; received a "
                "different file. Start over with a new state and output"
            )
            raise UserError(message)
        self.number = self._skipped = number

    def saved(self, place: int) -> None:
        """Do nothing: rows can be read again from the file."""

    def close(self, *, discard: bool = False) -> None:
        """Close the file."""
        self.file.close()


class ParquetParts:
    """Folder of Parquet files, one per write, which Parquet readers open as one table.

    Args:
        path: path of the folder.
        parts: number of parts recorded in a state, beyond which parts are removed; None for a new folder.
        tail: hash of the last part.

    Raises:
        UserError: the folder does not match the state, or contains later parts of other origin.
    """

    def __init__(self, path: str, parts: int | None = None, tail: str = "") -> None:
        self.folder, self.size, self.digest = Path(path), parts or 0, tail
        if parts is None:
            self.folder.mkdir(parents=True)
            return
        found = {int(m[1]): one for one in self._files() if (m := NAMED.fullmatch(one.name))}
        whole = found.keys() >= {*range(1, parts + 1)}
        if not whole or (parts and digest_of(found[parts].read_bytes()) != tail):
            message = (
                f"output: expected {path} unchanged, with {parts} parts; received a changed file. Start "
                "over with a new state and output"
            )
            raise UserError(message)
        for number in found.keys() - {*range(1, parts + 1)}:
            if not is_own(found[number]):
                message = f"output: expected parts written by ahnn; received {found[number]}. Move it"
                raise UserError(message)
            remove_own(found[number])

    def write(self, content: bytes) -> None:
        """Write a part atomically."""
        self.size += 1
        self.digest = digest_of(content)
        write_atomically(self.folder / PART.format(self.size), content)

    def sync(self) -> None:
        """Do nothing: parts are flushed when written."""

    def close(self) -> None:
        """Do nothing: no file is open."""

    def remove(self, path: str) -> None:
        """Remove the output."""
        for file in self._files():
            remove_own(file)
        if not any(self.folder.iterdir()):
            self.folder.rmdir()

    def _files(self) -> list[Path]:
        return [*self.folder.glob("*.parquet")] if self.folder.is_dir() else []

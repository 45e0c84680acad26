"""Storage of a study: a journal file, SQLite or PostgreSQL; with one lock per storage.

The lock makes the creation of a study and the allotment of trials atomic over all processes and machines:
without it, two processes that create the same empty database crash (SQLite "table already exists", PostgreSQL
UniqueViolation) and workers overshoot the number of trials. The operating system or the server releases it
when its holder is killed.
"""

from __future__ import annotations

import fcntl
import functools
import logging
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ahnn.errors import UserError

if TYPE_CHECKING:
    import optuna

logger = logging.getLogger(__name__)

JOURNAL = "journal:///"
SQLITE = "sqlite:///"
_ATTEMPTS = 6  # waits of 0.5, 1, 2, 4, 8 s: a database server that is just starting
_ADVISORY_KEY = 0x61686E6E  # "ahnn" in ASCII: any fixed 64-bit number


def resolved(url: str) -> str:
    """Return the URL with an absolute path, because jobs may run in another working directory.

    Raises:
        UserError: for a scheme that is not journal, sqlite or postgresql.
    """
    for scheme in (JOURNAL, SQLITE):
        if url.startswith(scheme):
            return scheme + str(Path(url.removeprefix(scheme)).absolute())
    if not url.startswith("postgresql"):
        message = (
            "sweeper storage: expected journal:///PATH, sqlite:///PATH or postgresql+psycopg://HOST/DATABASE"
            f"; received {url!r}"
        )
        raise UserError(message)
    return url


@functools.lru_cache(maxsize=4)
def open_storage(url: str) -> optuna.storages.BaseStorage:
    """Open a storage, one per process and URL, creating missing files or tables.

    Args:
        url: a resolved URL.

    Raises:
        UserError: if the database cannot be reached after several attempts.
    """
    from optuna.exceptions import StorageInternalError
    from sqlalchemy.exc import SQLAlchemyError

    for attempt in range(_ATTEMPTS):
        try:
            with exclusive(url):
                return _create(url)
        except (SQLAlchemyError, StorageInternalError, OSError) as error:
            if attempt == _ATTEMPTS - 1:
                message = (
                    f"sweeper storage: expected a reachable, writable {url.partition(':')[0]} storage; after "
                    f"{_ATTEMPTS} attempts received {type(error).__name__}: {error}; "
                    "check hydra.sweeper.storage"
                )
                raise UserError(message) from error
            logger.warning("storage is not ready (%s), trying again", type(error).__name__)
            time.sleep(0.5 * 2**attempt)
    raise AssertionError


@contextmanager
def exclusive(url: str) -> Iterator[None]:
    """Acquire the storage's lock, waiting for other holders.

    Args:
        url: a resolved URL.
    """
    path = _path(url)
    if path is None:
        with _advisory_lock(url):
            yield
    else:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.with_name(path.name + ".ask").open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield


def _path(url: str) -> Path | None:
    """Return the file of a storage, or None for a server."""
    for scheme in (JOURNAL, SQLITE):
        if url.startswith(scheme):
            return Path(url.removeprefix(scheme))
    return None


def _create(url: str) -> optuna.storages.BaseStorage:
    from optuna.exceptions import ExperimentalWarning
    from optuna.storages import JournalStorage, RDBStorage
    from optuna.storages.journal import JournalFileBackend

    from hydra_plugins.ahnn_sweeper._flock import FileLock

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        if url.startswith(JOURNAL):
            path = url.removeprefix(JOURNAL)
            return JournalStorage(JournalFileBackend(path, lock_obj=FileLock(path)))
        if url.startswith(SQLITE):
            return RDBStorage(url, engine_kwargs={"connect_args": {"timeout": 60}})
        return RDBStorage(url, engine_kwargs={"pool_pre_ping": True})


@contextmanager
def _advisory_lock(url: str) -> Iterator[None]:
    """Hold PostgreSQL's advisory lock; released with the connection, also if this process is killed."""
    from sqlalchemy import NullPool, create_engine, text

    engine = create_engine(url, poolclass=NullPool, isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        connection.execute(text("SELECT pg_advisory_lock(:key)"), {"key": _ADVISORY_KEY})
        yield

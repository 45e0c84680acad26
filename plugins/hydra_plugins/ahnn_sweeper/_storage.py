"""Storage of a study: a journal file, SQLite, PostgreSQL or Optuna's proxy, with one lock per storage.

The lock makes the creation of a study and the allotment of trials atomic over all processes and machines:
without it, two processes that create the same empty database crash (SQLite "table already exists", PostgreSQL
UniqueViolation) and workers overshoot the number of trials. The operating system or the server releases the
lock when its holder is killed. A proxy (`optuna.storages.run_grpc_proxy_server`) has no locks, but it numbers
trials: its lock is a queue of trials in a separate study, in which a killed process leaves an orphan.
"""

from __future__ import annotations

import functools
import logging
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from ahnn.errors import UserError
from ahnn.locks import lock
from hydra_plugins.ahnn_sweeper._owner import Lease, is_alive, this_process

if TYPE_CHECKING:
    import optuna

logger = logging.getLogger(__name__)

JOURNAL = "journal:///"
SQLITE = "sqlite:///"
GRPC = "grpc://"
_QUEUE = "ahnn queue"  # the study whose trials wait for a proxy's lock
_ATTEMPTS = 6  # with waits of 0.5, 1, 2, 4, 8 s, for a database server that is starting
_ADVISORY_KEY = 0x61686E6E  # "ahnn" in ASCII: any fixed 64-bit number


def resolved(url: str) -> str:
    """Return the URL with an absolute path, because jobs may run in another working directory.

    Raises:
        UserError: for a scheme other than journal, sqlite, postgresql or grpc, or a proxy without a port.
    """
    for scheme in (JOURNAL, SQLITE):
        if url.startswith(scheme):
            return scheme + str(Path(url.removeprefix(scheme)).absolute())
    if not (url.startswith("postgresql") or (url.startswith(GRPC) and _has_port(url))):
        message = (
            "sweeper storage: expected journal:///PATH, sqlite:///PATH, postgresql+psycopg://HOST/DATABASE "
            f"or grpc://HOST:PORT; received {url!r}"
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
            with nullcontext() if url.startswith(GRPC) else exclusive(url):
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
        with _queued(open_storage(url)) if url.startswith(GRPC) else _advisory_lock(url):
            yield
    else:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.with_name(path.name + ".ask").open("w") as file:
            lock(file)
            yield


def _path(url: str) -> Path | None:
    """Return the file of a storage, or None for a server."""
    for scheme in (JOURNAL, SQLITE):
        if url.startswith(scheme):
            return Path(url.removeprefix(scheme))
    return None


def _create(url: str) -> optuna.storages.BaseStorage:
    from optuna.exceptions import ExperimentalWarning
    from optuna.storages import GrpcStorageProxy, JournalStorage, RDBStorage
    from optuna.storages.journal import JournalFileBackend

    from hydra_plugins.ahnn_sweeper._flock import FileLock

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        if url.startswith(JOURNAL):
            path = url.removeprefix(JOURNAL)
            return JournalStorage(JournalFileBackend(path, lock_obj=FileLock(path)))
        if url.startswith(SQLITE):
            return RDBStorage(url, engine_kwargs={"connect_args": {"timeout": 60}})
        if url.startswith(GRPC):
            place = urlsplit(url)
            proxy = GrpcStorageProxy(host=place.hostname or "", port=place.port or 0)
            proxy.wait_server_ready(timeout=5.0)
            return proxy
        return RDBStorage(url, engine_kwargs={"pool_pre_ping": True})


def _has_port(url: str) -> bool:
    try:
        place = urlsplit(url)
        return bool(place.hostname and place.port)
    except ValueError:
        return False


@contextmanager
def _queued(storage: optuna.storages.BaseStorage) -> Iterator[None]:
    """Hold the lock of a proxy, which is granted in the order of the trial numbers in the queue."""
    from optuna.exceptions import DuplicatedStudyError, UpdateFinishedTrialError
    from optuna.study import StudyDirection
    from optuna.trial import TrialState, create_trial

    with suppress(DuplicatedStudyError):
        storage.create_new_study([StudyDirection.MINIMIZE], _QUEUE)
    queue = storage.get_study_id_from_name(_QUEUE)
    ticket = create_trial(state=TrialState.RUNNING, user_attrs={"run_by": this_process()})
    own = storage.create_new_trial(queue, ticket)
    with Lease(storage, [own]):
        try:
            while ahead := [t for t in _waiting(storage, queue) if t._trial_id < own]:
                for orphan in (t for t in ahead if not is_alive(t)):
                    with suppress(UpdateFinishedTrialError):
                        storage.set_trial_state_values(orphan._trial_id, TrialState.FAIL)
                time.sleep(0.02)
            yield
        finally:
            storage.set_trial_state_values(own, TrialState.FAIL)


def _waiting(storage: optuna.storages.BaseStorage, queue: int) -> list[optuna.trial.FrozenTrial]:
    """Return the trials of a queue that hold the lock or wait for it."""
    from optuna.trial import TrialState

    return storage.get_all_trials(queue, deepcopy=False, states=(TrialState.RUNNING,))


@contextmanager
def _advisory_lock(url: str) -> Iterator[None]:
    """Hold PostgreSQL's advisory lock, released with the connection even if this process is killed."""
    from sqlalchemy import NullPool, create_engine, text

    engine = create_engine(url, poolclass=NullPool, isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        connection.execute(text("SELECT pg_advisory_lock(:key)"), {"key": _ADVISORY_KEY})
        yield

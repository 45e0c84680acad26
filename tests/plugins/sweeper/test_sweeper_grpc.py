"""A study behind a proxy server of Optuna, on loopback."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import optuna
import pytest
from test_sweeper_kill import workers_share

from ahnn.errors import UserError
from hydra_plugins.ahnn_sweeper._ledger import allot
from hydra_plugins.ahnn_sweeper._storage import exclusive, open_storage, resolved
from hydra_plugins.ahnn_sweeper._study import open_study

SERVE = """
import sys, warnings
warnings.simplefilter("ignore")
from optuna.storages import RDBStorage, run_grpc_proxy_server
run_grpc_proxy_server(RDBStorage("sqlite:///" + sys.argv[1]), host="127.0.0.1", port=int(sys.argv[2]))
"""


@pytest.fixture(scope="module")
def proxy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with closing(socket.socket()) as place:
        place.bind(("127.0.0.1", 0))
        port = place.getsockname()[1]
    path = tmp_path_factory.mktemp("proxy") / "study.db"
    server = subprocess.Popen([sys.executable, "-c", SERVE, str(path), str(port)])
    yield f"grpc://127.0.0.1:{port}"
    server.kill()
    server.wait()


def test_a_study_is_made_shared_and_goes_on_behind_a_proxy(proxy: str):
    space = {"x": optuna.distributions.FloatDistribution(0.0, 1.0)}
    random = optuna.samplers.RandomSampler(seed=0)
    study = open_study(proxy, "parts", "minimize", ["a=1"])
    (first,) = allot(study, proxy, space, lambda _: random, total=3, limit=1)
    study.tell(first.number, 0.5)
    again = open_study(proxy, "parts", "minimize", ["a=1"])
    assert [t.number for t in allot(again, proxy, space, lambda _: random, total=3, limit=3)] == [1, 2]
    with pytest.raises(UserError, match="study 'parts' in grpc storage: expected to be continued with"):
        open_study(proxy, "parts", "minimize", ["a=2"])


def test_the_lock_of_a_proxy_has_one_holder_and_survives_one_that_was_killed(proxy: str):
    storage = open_storage(proxy)
    with exclusive(proxy):
        queue = storage.get_study_id_from_name("ahnn queue")
    gone = optuna.trial.create_trial(state=optuna.trial.TrialState.RUNNING)
    orphan = storage.create_new_trial(queue, gone)  # of nobody that is alive
    inside, most = [], []

    def work() -> None:
        with exclusive(proxy):
            inside.append(1)
            most.append(len(inside))
            time.sleep(0.02)
            inside.pop()

    threads = [threading.Thread(target=work) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=30)
    assert most == [1] * 6
    assert storage.get_trial(orphan).state == optuna.trial.TrialState.FAIL


def test_a_proxy_has_a_host_and_a_port():
    assert resolved("grpc://host:13000") == "grpc://host:13000"
    for wrong in ("grpc://host", "grpc://:13000", "grpc://host:port"):
        with pytest.raises(UserError, match="grpc://HOST:PORT; received"):
            resolved(wrong)


@pytest.mark.slow
def test_two_workers_share_a_proxy_and_one_is_killed(tmp_path: Path, proxy: str):
    workers_share(tmp_path / "sweep", 2, 9, f"hydra.sweeper.storage={proxy}", storage=proxy)

"""The launcher of `hydra/launcher=ahnn_ray`: each job in a separate process, started by a Ray task.

If the worker of a job is killed, the job ends with it. A job of a search is then a failed trial, which the
search repeats. Any other job restarts in another worker from its last checkpoint, in the same folder, which
all machines must be able to access.

Hydra executes this module outside `sys.modules`: do not combine postponed annotations with dataclasses.
"""

import math
import os
import signal
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.core.utils import JobReturn

from ahnn import workers
from hydra_plugins.ahnn_sweeper import _forked
from hydra_plugins.ahnn_sweeper.launcher import ProcessLauncher, program


class RayLauncher(ProcessLauncher):
    """Run every job as a Ray task.

    Args:
        n_jobs: number of jobs given to Ray together; they run in parallel if Ray has enough processors.
        cpus: number of processors of a job.
        gpus: number of GPUs of a job, or a fraction of one.
        retries: number of restarts of a job outside a search whose worker is killed.
        init: arguments of `ray.init`, such as `address`.
        imports: modules imported once for all jobs of a worker.
    """

    def __init__(
        self,
        n_jobs: int,
        cpus: float,
        gpus: float,
        retries: int,
        init: Mapping[str, Any],
        imports: Sequence[str] = (),
    ) -> None:
        super().__init__(n_jobs, imports)
        self.cpus, self.gpus, self.retries, self.init = cpus, gpus, retries, dict(init)
        self._ray: Any = None

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Run the jobs and wait for all of them, even if some fail."""
        self._ray = workers.connected(math.ceil(self.n_jobs * self.cpus), **self.init)
        return super().launch(job_overrides, initial_job_idx)

    def _stop(self) -> None:
        for task in list(self._running):
            self._ray.cancel(task)

    def _exit_code(self, arguments: list[str], log: Path) -> int:
        retries = 0 if any(text.startswith("trial=") for text in arguments) else self.retries
        options = {"num_cpus": self.cpus, "num_gpus": self.gpus, "max_retries": retries}
        task = self._ray.remote(**options)(_job).remote
        job = task(os.getcwd(), self.imports, program(), arguments, str(log))
        self._running.add(job)
        try:
            return self._ray.get(job)
        except self._ray.exceptions.WorkerCrashedError:
            return -signal.SIGKILL
        except self._ray.exceptions.TaskCancelledError:
            return -signal.SIGTERM
        finally:
            self._running.discard(job)


def _job(folder: str, imports: Sequence[str], name: str, arguments: list[str], log: str) -> int:
    """Run a command in the folder of the sweep, in a process bound to this worker; return its exit code."""
    os.chdir(folder)
    if Path(log).parent.joinpath("checkpoints", "last.ckpt").exists():  # left by a killed worker
        arguments = [*arguments, "ckpt=last"]
    _forked.serve(imports)
    process = _forked.start(name, arguments, Path(log), bound=True)
    try:
        return _forked.exit_code(process)
    except KeyboardInterrupt:  # sweep stopped: let the training write its checkpoint
        process.terminate()
        return _forked.exit_code(process)

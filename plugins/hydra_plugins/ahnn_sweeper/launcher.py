"""The launcher of `hydra/launcher=ahnn_process`: each job in a separate process.

Hydra's basic launcher runs the jobs inside the sweep, so that a job killed for lack of memory ends the sweep;
joblib stops all jobs when one of its workers dies. Here each job runs the user's command as a single run, in
a fork of a process with the common imports. A killed job is then only one failed job, and Lightning's DDP,
which starts its other processes by repeating the command, repeats the right one.

Hydra executes this module outside `sys.modules`: do not combine postponed annotations with dataclasses.
"""

import logging
import os
import signal
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.process import BaseProcess
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, JobStatus, filter_overrides, setup_globals
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf, open_dict

from hydra_plugins.ahnn_sweeper import _forked

logger = logging.getLogger(__name__)
_CONFIG_FLAGS = ("config_path", "config_name", "config_dir")
_TAIL = 5  # number of output lines of a failed job shown immediately


class ProcessLauncher(Launcher):
    """Run every job as a process, at most `n_jobs` at a time.

    The output of a job is in the `console.log` of its folder.

    Args:
        n_jobs: number of parallel jobs.
        imports: modules imported once for all jobs.
    """

    def __init__(self, n_jobs: int, imports: Sequence[str] = ()) -> None:
        self.n_jobs = n_jobs
        self.imports = [*imports]
        self.config: DictConfig | None = None
        self.hydra_context: HydraContext | None = None
        self._running: set[BaseProcess] = set()
        self._ended = False

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """Store Hydra's arguments; the task is invoked through the command line."""
        self.config = config
        self.hydra_context = hydra_context

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Run the jobs and wait for all of them, even if some fail."""
        setup_globals()
        _forked.serve(self.imports)
        numbers = range(initial_job_idx, initial_job_idx + len(job_overrides))
        folders = [self._folder(n, list(o)) for n, o in zip(numbers, job_overrides, strict=True)]
        pool = ThreadPoolExecutor(self.n_jobs)
        self._ended = False
        try:
            returns = list(pool.map(self._run, numbers, job_overrides, folders))
        finally:  # also if the sweep is interrupted
            self._ended = True
            pool.shutdown(wait=False, cancel_futures=True)
            self._stop()
        failed = [job for job in returns if job.status == JobStatus.FAILED]
        if len(job_overrides) > 1 and failed:
            reasons = "\n".join(f"    {job._return_value}" for job in failed)
            logger.error("%d of %d jobs failed:\n%s", len(failed), len(returns), reasons)
        return returns

    def _folder(self, number: int, overrides: list[str]) -> Path:
        """Compose the job, to detect wrong overrides before any run, and return its folder."""
        assert self.config is not None
        assert self.hydra_context is not None
        config = self.hydra_context.config_loader.load_sweep_config(self.config, overrides)
        with open_dict(config):
            config.hydra.job.id = str(number)
            config.hydra.job.num = number
        before = HydraConfig.instance().cfg
        HydraConfig.instance().set_config(config)
        try:
            return Path(str(config.hydra.sweep.dir)).absolute() / str(config.hydra.sweep.subdir)
        finally:
            HydraConfig.instance().cfg = before

    def _run(self, number: int, overrides: Sequence[str], folder: Path) -> JobReturn:
        """Run one job and return its outcome."""
        folder.mkdir(parents=True, exist_ok=True)
        logger.info("\t#%d : %s", number, " ".join(filter_overrides(overrides)))
        begin = time.monotonic()
        log = folder / "console.log"
        code = self._exit_code(self._arguments(number, overrides, folder), log)
        job = JobReturn(overrides=list(overrides), working_dir=os.getcwd(), status=JobStatus.COMPLETED)
        if code != 0:
            how = (
                f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
            )
            reason = f"job #{number} {how} after {time.monotonic() - begin:.1f} s; its output is in {log}"
            job.status, job._return_value = JobStatus.FAILED, RuntimeError(reason)
            if not self._ended:  # an interrupted sweep reports the reason itself
                tail = log.read_text(errors="replace").splitlines()[-_TAIL:]
                logger.error("%s\n%s", reason, "\n".join(f"    {line}" for line in tail))
        return job

    def _stop(self) -> None:
        """Terminate the running jobs."""
        for process in list(self._running):
            process.terminate()

    def _exit_code(self, arguments: list[str], log: Path) -> int:
        """Run a command to its end and return its exit code, or the negative number of the signal."""
        process = _forked.start(program(), arguments, log)
        self._running.add(process)
        if self._ended:  # the sweep was interrupted during the start
            process.terminate()
        code = _forked.exit_code(process)
        self._running.discard(process)
        return code

    def _arguments(self, number: int, overrides: Sequence[str], folder: Path) -> list[str]:
        """Return the arguments of the command that runs one job of this sweep as a single run."""
        assert self.config is not None
        flags = []
        args = _hydra_arguments()
        for name in _CONFIG_FLAGS:
            if getattr(args, name):
                flags += [f"--{name.replace('_', '-')}", getattr(args, name)]
        hydra = OmegaConf.to_container(self.config.hydra.overrides.hydra)
        assert isinstance(hydra, list)
        kept = [line for line in hydra if not str(line).startswith(("hydra.mode=", "hydra.run.dir="))]
        sweep_dir = Path(str(self.config.hydra.sweep.dir)).absolute()
        own = [
            "hydra.mode=RUN",
            f"hydra.sweep.dir='{sweep_dir}'",
            f"hydra.run.dir='{folder}'",
            f"hydra.job.num={number}",
        ]
        return [*flags, *map(str, kept), *overrides, *own]


def program() -> str:
    """Return the module or the script that this process runs."""
    import __main__

    spec = __main__.__spec__
    return os.path.abspath(sys.argv[0]) if spec is None else spec.name.removesuffix(".__main__")


def _hydra_arguments():  # noqa: ANN202 - argparse.Namespace
    from hydra._internal.utils import get_args_parser

    return get_args_parser().parse_args(sys.argv[1:])

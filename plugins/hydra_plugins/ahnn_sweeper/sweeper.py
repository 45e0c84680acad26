"""Sweeper instantiated by Hydra for `hydra/sweeper=ahnn_optuna`.

Hydra executes this module outside `sys.modules`, so it must not combine postponed annotations with
dataclasses. It imports Optuna inside functions, since every Hydra application imports this module at start.
"""

import copy
import logging
import signal
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.plugins import Plugins
from hydra.errors import HydraException
from hydra.plugins.launcher import Launcher
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, RunMode, TaskFunction
from omegaconf import DictConfig, OmegaConf, open_dict

from ahnn.errors import Stopped, UserError
from ahnn.files import write_atomically

if TYPE_CHECKING:
    import optuna

    from hydra_plugins.ahnn_sweeper._space import SearchSpace

logger = logging.getLogger(__name__)
_IN_PROCESS = ("BasicLauncher", "JoblibLauncher", "LocalLauncher")


class AhnnOptunaSweeper(Sweeper):
    """Search with Optuna: every job is a trial, and the study can be continued and shared.

    Args:
        study_name: name of the study in its storage.
        storage: `journal:///PATH`, `sqlite:///PATH`, `postgresql+psycopg://HOST/DATABASE` or
            `grpc://HOST:PORT`, Optuna's proxy; null for a journal file in the sweep folder.
        direction: `minimize` or `maximize` the value that the job returns.
        n_trials: total number of trials of the study, over all runs and machines.
        batch_size: number of trials passed to the launcher together.
        sampler: configuration of an Optuna sampler. A seed in it is combined with the number of each trial,
            so that continued studies and parallel workers draw different parameters.
        params: search space, key to sweep in Hydra's grammar; see `_space`.
        below: for each pair `key: other`, `key` is set to half of `other` if its draw is equal or larger.
    """

    def __init__(
        self,
        study_name: str,
        storage: str | None,
        direction: Literal["minimize", "maximize"],
        n_trials: int,
        batch_size: int,
        sampler: DictConfig,
        params: DictConfig,
        below: DictConfig,
    ) -> None:
        self.study_name = study_name
        self.storage = storage
        self.direction: Literal["minimize", "maximize"] = direction
        self.n_trials = n_trials
        self.batch_size = batch_size
        self.sampler = sampler
        self.params = params
        self.below = below
        self.config: DictConfig | None = None
        self.launcher: Launcher | None = None
        self.hydra_context: HydraContext | None = None
        self.task_function: TaskFunction | None = None

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """Store Hydra's arguments and build the launcher."""
        self.config = config
        self.hydra_context = hydra_context
        self.task_function = task_function
        self.launcher = Plugins.instance().instantiate_launcher(
            hydra_context=hydra_context, task_function=task_function, config=config
        )

    def sweep(self, arguments: list[str]) -> None:
        """Run trials until the study has `n_trials`, then write the results.

        Raises:
            HydraException: invalid search space, storage or study or, at the end, a trial that failed for a
                reason other than pruning. Hydra shows a message without a traceback; the exit code is 1.
            Stopped: on a signal; the message explains how the search continues.
        """
        try:
            failed = self._sweep(arguments)
        except UserError as error:
            raise HydraException(str(error)) from error
        except (KeyboardInterrupt, Stopped) as stop:
            known = stop if isinstance(stop, Stopped) else Stopped(signal.SIGINT)
            raise known if str(known) else known.saying("repeat the command to continue the search") from None
        if failed:
            message = f"{failed} of {self.n_trials} trials failed; the table above names them"
            raise HydraException(message)

    def _sweep(self, arguments: Sequence[str]) -> int:
        """Run the search and return the number of failed trials."""
        from hydra_plugins.ahnn_sweeper import _report, _study

        assert self.config is not None
        assert self.hydra_context is not None
        space = self._space(arguments)
        sweep_dir = Path(str(self.config.hydra.sweep.dir)).absolute()
        write_atomically(sweep_dir / "multirun.yaml", OmegaConf.to_yaml(self.config).encode())
        url = _study.url(self.storage, sweep_dir)
        study = _study.open_study(url, self.study_name, self.direction, space.fixed)
        self._run(study, url, space)
        return _report.write(
            study, sweep_dir, self.hydra_context.config_loader, set(self.config.hydra.runtime.choices)
        )

    def _space(self, arguments: Sequence[str]) -> "SearchSpace":
        """Return the search space, after composing one draw to detect wrong keys."""
        import optuna

        from hydra_plugins.ahnn_sweeper import _space

        optuna.logging.set_verbosity(optuna.logging.WARNING)
        assert self.hydra_context is not None
        parser = OverridesParser.create(config_loader=self.hydra_context.config_loader)
        space = _space.parse(parser, self.params, arguments)
        if not space.distributions:
            message = (
                "sweeper: expected at least one key to search; received none in hydra.sweeper.params nor on "
                "the command line; add for example sweep=quick or optimizer.lr='tag(log, interval(1e-4, "
                "1e-2))'"
            )
            raise UserError(message)
        draw = optuna.create_study().ask(space.distributions)
        job = [*space.fixed, *space.overrides(draw.params), "trial=null"]
        assert self.config is not None
        composed = self.hydra_context.config_loader.load_sweep_config(self.config, job)
        self._refuse_shared_process(composed)
        self._check(composed)
        return space

    def _check(self, job: DictConfig) -> None:
        """Validate a job with the task's attribute `check`, unless jobs run on other machines."""
        assert self.config is not None
        check = getattr(self.task_function, "check", None)
        if check is None or "submitit" in str(self.config.hydra.launcher.get("_target_")):
            return
        before = HydraConfig.instance().cfg
        with open_dict(job):
            job.hydra.job.id, job.hydra.job.num = "0", 0
            job.hydra.mode = RunMode.RUN  # multi-device jobs are detected in single runs
            job.hydra.runtime.output_dir = str(Path(str(self.config.hydra.sweep.dir)).absolute() / "0")
            HydraConfig.instance().set_config(job)
        task = copy.deepcopy(job)  # a copy still resolves references to `hydra:`
        with open_dict(task):
            del task["hydra"]
        try:
            check(task)
        finally:
            HydraConfig.instance().cfg = before

    def _refuse_shared_process(self, job: DictConfig) -> None:
        """Reject multi-device jobs in this process, since Lightning would repeat the sweep on each."""
        assert self.config is not None
        devices = OmegaConf.select(job, "trainer.devices")
        launcher = str(self.config.hydra.launcher.get("_target_")).rpartition(".")[2]
        if isinstance(devices, int) and devices > 1 and launcher in _IN_PROCESS:
            message = (
                f"sweeper: expected a launcher that starts a separate process for a job on {devices} "
                f"devices; received {launcher}; add hydra/launcher=ahnn_process"
            )
            raise UserError(message)

    def _run(self, study: "optuna.Study", url: str, space: "SearchSpace") -> None:
        """Launch trials until none remains and none runs in other workers."""
        import time

        from hydra_plugins.ahnn_sweeper import _ledger, _study
        from hydra_plugins.ahnn_sweeper._progress import Progress

        def sampler_for(number: int) -> "optuna.samplers.BaseSampler":
            return _study.sampler(self.sampler, number)

        with Progress(study, self.n_trials) as progress:
            while True:
                batch = _ledger.allot(
                    study, url, space.distributions, sampler_for, self.n_trials, self.batch_size
                )
                if batch:
                    self._launch(study, url, space, batch)
                elif not _ledger.count(study.get_trials(deepcopy=False)).running:
                    return
                else:
                    time.sleep(1.0)
                progress.update()

    def _launch(
        self, study: "optuna.Study", url: str, space: "SearchSpace", batch: "list[optuna.Trial]"
    ) -> None:
        """Launch one batch; afterwards, each of its trials is finished or requeued in any case."""
        from hydra_plugins.ahnn_sweeper import _ledger
        from hydra_plugins.ahnn_sweeper._owner import Lease

        assert self.launcher is not None
        jobs = []
        for trial in batch:
            overrides = [*space.fixed, *space.overrides(_kept_below(trial.params, self.below))]
            trial.set_user_attr("overrides", overrides)
            jobs.append([*overrides, *self._trial_overrides(url, trial)])
        all_ended = True
        with Lease(study._storage, [trial._trial_id for trial in batch]):
            try:
                self.launcher.launch(jobs, initial_job_idx=batch[0].number)
            except Exception as error:  # joblib raises if a worker is killed
                if not _ledger.any_started(study, [trial.number for trial in batch]):
                    raise
                all_ended = False
                logger.warning("the launcher stopped: %s: %s", type(error).__name__, error)
            _ledger.settle(study, url, [trial.number for trial in batch], all_ended)

    def _trial_overrides(self, url: str, trial: "optuna.Trial") -> list[str]:
        """Return the overrides that pass a trial to its job; its folder is named by the trial number."""
        node = (
            f"{{_target_:hydra_plugins.ahnn_sweeper.load_trial,storage:'{url}',"
            f"study_name:'{self.study_name}',trial_id:{trial._trial_id}}}"
        )
        return [f"trial={node}", f"hydra.sweep.subdir='{trial.number}'"]


def _kept_below(params: Mapping[str, Any], below: Mapping[Any, Any]) -> dict[str, Any]:
    """Return the parameters with each key of `below` less than its counterpart, if both are searched.

    The study keeps the drawn value, so that all draws above the limit have the same outcome.
    """
    used = dict(params)
    for key, other in below.items():
        if key in used and other in used and used[key] >= used[other]:
            used[key] = 0.5 * used[other]
    return used

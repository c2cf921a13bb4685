"""Many trials on Dask: written as they finish, resumed where they stopped.

One file a trial, named by the trial's key, put in place as a whole. A file holds nothing that
depends on where or when the trial ran, so the same trial gives the same bytes on one worker or ten.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import logging
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from app.console import count
from app.studies.experiments.protocol import Outcome, Trial, run

_DEAF = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
RETRIES = 5  # a worker may die under a trial this often before the trial is given up


class ClusterLost(OSError):
    """The scheduler or its workers are gone; the message says which. What was done is written."""


def grid(
    *,
    experiments: Sequence[str],
    operators: int,
    meshes: Sequence[str],
    rules: Sequence[str],
    noise: Sequence[float],
    trials: int = 1,
    seed: int = 0,
    rate: float = 1000.0,
    length: float | None = None,
) -> list[Trial]:
    """Every combination; operators are numbered from 1, 0 being the calibrated one.

    Raises:
        OptionError: a value that no trial can have.
    """
    return [
        Trial(experiment, rule, number, operator, mesh, error, seed=seed, rate=rate, length=length)
        for experiment, operator, mesh, error, number, rule in itertools.product(
            experiments, range(1, operators + 1), meshes, noise, range(trials), rules
        )
    ]


def run_all(
    trials: Iterable[Trial],
    folder: Path,
    *,
    workers: int = 2,
    scheduler: str | None = None,
    done: Callable[[Outcome], None] = lambda _outcome: None,
) -> list[Outcome]:
    """Do the trials that are not done yet, and return the outcomes of all, in order.

    Args:
        folder: where each trial's file is and goes.
        workers: processes of the local cluster, one thread each; 0 computes here, without Dask.
        scheduler: address of a Dask cluster to use instead, such as tcp://host:8786. Its workers
            need the same version of this package.
        done: called after each trial was written, and for each that was there already.

    Raises:
        ImportError: Dask is needed and not installed.
        ClusterLost: the scheduler or the workers are gone before all trials are done.
        OSError: the scheduler cannot be reached, or the folder not be written.
    """
    wanted = list(trials)
    folder.mkdir(parents=True, exist_ok=True)
    outcomes: dict[str, Outcome] = {}
    missing = []
    for trial in wanted:
        outcome = _read(folder, trial)
        if outcome is None:
            missing.append(trial)
        else:
            outcomes[trial.key] = outcome
            done(outcome)
    if missing:
        results = (
            map(outcome_text, missing) if workers == 0 and scheduler is None
            else _distributed(missing, workers, scheduler)
        )  # fmt: skip
        for text in results:
            outcome = Outcome.from_json(json.loads(text))
            _write(folder, outcome.trial, text)
            outcomes[outcome.trial.key] = outcome
            done(outcome)
    return [outcomes[trial.key] for trial in wanted]


def outcome_text(trial: Trial) -> str:
    """Do one trial: what its file says. Runs on the workers."""
    outcome = run(trial)
    plain = dataclasses.replace(outcome, elapsed=0.0, driving=0.0, trajectory=np.empty((0, 4)))
    return json.dumps(plain.to_json(), sort_keys=True) + "\n"


def _distributed(trials: Sequence[Trial], workers: int, scheduler: str | None) -> Iterator[str]:
    from concurrent.futures import CancelledError

    from distributed import KilledWorker, as_completed
    from distributed.comm import CommClosedError

    with _client(workers, scheduler) as client:
        try:
            futures = [
                client.submit(outcome_text, trial, key=trial.key, retries=RETRIES, pure=False)
                for trial in trials
            ]
            for _future, text in as_completed(futures, with_results=True):
                if isinstance(text, CancelledError):  # given, not raised
                    raise text
                yield text
        except KilledWorker as error:
            raise ClusterLost(
                f"{count(RETRIES + 1, 'worker')} died under the trial {error.task}: is there "
                "enough memory?"
            ) from None
        except (CancelledError, CommClosedError, TimeoutError) as error:
            raise ClusterLost("the scheduler is gone") from error


@contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[Any]:
    import dask
    from distributed import Client, LocalCluster

    settings = {
        "distributed.scheduler.allowed-failures": RETRIES,
        # An interrupt is for the study, which ends its workers.
        "distributed.worker.preload": [_DEAF],
    }
    # What becomes of workers and scheduler is told in one line at the end.
    for name in [*logging.root.manager.loggerDict]:
        if name.partition(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL)
    with dask.config.set(settings):
        if scheduler is not None:
            with Client(scheduler, timeout="10s") as client:
                yield client
            return
        # For this machine alone, on free ports: another study may be running beside this one.
        with (
            LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True,
                dashboard_address="127.0.0.1:0", host="127.0.0.1", silence_logs=logging.CRITICAL,
            ) as cluster,
            Client(cluster) as client,
        ):  # fmt: skip
            yield client


def _path(folder: Path, trial: Trial) -> Path:
    return folder / f"{trial.key}.json"


def _read(folder: Path, trial: Trial) -> Outcome | None:
    """The outcome in a trial's file; None if there is none, or what is there is of no use."""
    try:
        outcome = Outcome.from_json(json.loads(_path(folder, trial).read_text("utf-8")))
    except (OSError, ValueError, TypeError, KeyError):
        return None
    return outcome if outcome.trial == trial else None


def _write(folder: Path, trial: Trial, text: str) -> None:
    path = _path(folder, trial)
    partial = path.with_suffix(f".{os.getpid()}.part")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)

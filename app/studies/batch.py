"""Runs many trials on Dask; each is written when it finishes, so that a study can be resumed.

One file per trial, named by the trial's key, written atomically. It contains nothing that depends
on where or when the trial ran, so the number of workers does not change its bytes.
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

_IGNORE_SIGINT = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
RETRIES = 5  # of a trial whose worker died


class ClusterLost(OSError):
    """The scheduler or its workers are lost; finished trials are written."""


def grid(
    *,
    experiments: Sequence[str],
    operators: int,
    meshes: Sequence[str],
    rules: Sequence[str],
    noise: Sequence[float],
    margins: Sequence[float] = (0.0,),
    trials: int = 1,
    seed: int = 0,
    rate: float = 1000.0,
    length: float | None = None,
) -> list[Trial]:
    """Every combination; operators are numbered from 1, 0 being the calibrated one.

    Raises:
        OptionError: an invalid value.
    """
    return [
        Trial(
            experiment, rule, number, operator, mesh, error, seed=seed, rate=rate, length=length,
            margin=margin if rule != "off" else 0.0,
        )
        for experiment, operator, mesh, error, number, rule, margin in itertools.product(
            experiments, range(1, operators + 1), meshes, noise, range(trials), rules, margins
        )
        if rule != "off" or margin == margins[0]  # which has no fixture to have margins
    ]  # fmt: skip


def run_all(
    trials: Iterable[Trial],
    folder: Path,
    *,
    workers: int = 2,
    scheduler: str | None = None,
    done: Callable[[Outcome], None] = lambda _outcome: None,
) -> list[Outcome]:
    """Run the trials that have no file yet, and return the outcomes of all, in order.

    Args:
        folder: of the trials' files.
        workers: processes of the local cluster, one thread each; 0: in this process, without Dask.
        scheduler: address of a Dask cluster to use instead, such as tcp://host:8786. Its workers
            need the same version of this package.
        done: called after each trial was written, and for each that had a file.

    Raises:
        ImportError: Dask is needed and not installed.
        ClusterLost: the scheduler or the workers were lost before all trials were done.
        OSError: the scheduler cannot be reached, or the folder cannot be written.
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
    """Run one trial; returns the text of its file. Runs on the workers."""
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
                if isinstance(text, CancelledError):  # returned by Dask, not raised
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
        # Ctrl-C goes to this process, which ends its workers.
        "distributed.worker.preload": [_IGNORE_SIGINT],
    }
    # Errors of workers and scheduler are reported by `ClusterLost`.
    for name in [*logging.root.manager.loggerDict]:
        if name.partition(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL)
    with dask.config.set(settings):
        if scheduler is not None:
            with Client(scheduler, timeout="10s") as client:
                yield client
            return
        # Local, on free ports: another study may run at the same time.
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
    """The outcome in a trial's file; None if there is none, or it is invalid."""
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

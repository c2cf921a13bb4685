"""Studies: resumed, the same on any number of workers, and not hurt by a worker's death."""

import json
import os
import signal
import threading
import time
from pathlib import Path

import pytest

from app.commands import call
from app.studies import batch as study
from app.words import OptionError

GRID = {
    "experiments": ["cutting"],
    "operators": 2,
    "meshes": ["skull-coarse"],
    "rules": ["off", "certified"],
    "noise": [0.35e-3],
    "rate": 50.0,
    "length": 2e-3,
}


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_study_goes_on_where_it_stopped(tmp_path: Path, monkeypatch) -> None:
    trials = study.grid(**GRID)
    assert len(trials) == 4
    assert len({t.key for t in trials}) == 4

    class Stopped(Exception):
        pass

    seen = []

    def stop(outcome) -> None:
        seen.append(outcome.trial)
        if len(seen) == 2:
            raise Stopped

    with pytest.raises(Stopped):
        study.run_all(trials, tmp_path, workers=0, done=stop)
    before = files(tmp_path)
    assert set(before) == {f"{t.key}.json" for t in trials[:2]}
    (tmp_path / f"{trials[1].key}.json").write_text("{half")  # what a full disk may leave
    ran = []
    original = study.outcome_text
    monkeypatch.setattr(study, "outcome_text", lambda t: (ran.append(t), original(t))[1])
    outcomes = study.run_all(trials, tmp_path, workers=0)
    assert ran == trials[1:]
    assert [o.trial for o in outcomes] == trials
    after = files(tmp_path)
    assert {name: after[name] for name in before} == before
    assert not any(name.endswith(".part") for name in after)


@pytest.mark.slow
def test_two_workers_give_the_same_bytes_though_one_is_killed(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    trials = study.grid(**GRID)
    study.run_all(trials, tmp_path / "here", workers=0)
    killed = []

    def kill_one(client) -> None:
        pids = client.run(os.getpid)
        victim = sorted(pids.values())[0]
        os.kill(victim, signal.SIGKILL)
        killed.append(victim)

    original = study._client

    def watched(workers, scheduler):
        manager = original(workers, scheduler)

        class Watched:
            def __enter__(self):
                client = manager.__enter__()
                self.timer = threading.Timer(1.0, kill_one, (client,))
                self.timer.start()
                return client

            def __exit__(self, *error):
                self.timer.join()
                return manager.__exit__(*error)

        return Watched()

    study._client = watched
    try:
        began = time.monotonic()
        outcomes = study.run_all(trials, tmp_path / "there", workers=2)
    finally:
        study._client = original
    assert killed, f"done after {time.monotonic() - began:.1f} s, before anybody was killed"
    assert [o.trial for o in outcomes] == trials
    assert files(tmp_path / "there") == files(tmp_path / "here")


def test_the_command_writes_a_summary(tmp_path: Path, capsys) -> None:
    words = ["--operators", "1", "--meshes", "skull-coarse", "--rate", "50", "--length", "2mm",
             "--workers", "0", "--out", str(tmp_path)]  # fmt: skip
    assert call("study", words) == 0
    assert len(files(tmp_path / "trials")) == 2
    assert len((tmp_path / "summary.csv").read_text("utf-8").splitlines()) == 3
    assert "certified" in capsys.readouterr().out


def test_experiments_from_the_command_line(tmp_path: Path, capsys) -> None:
    words = ["cutting", "--mesh", "skull-coarse", "--rate", "50", "--length", "2mm",
             "--out", str(tmp_path)]  # fmt: skip
    assert call("experiment", words) == 0
    out = capsys.readouterr().out
    assert "0 violations" in out
    assert "0.63 ± 0.30" in out  # the paper's
    assert {"trials.csv", "stations.csv", "report.html"} <= {p.name for p in tmp_path.iterdir()}


@pytest.mark.parametrize(
    ("command", "words", "word"),
    [
        ("experiment", ["sewing"], "tracing, cutting"),
        ("experiment", ["cutting", "--rule", "all"], "certified, paper"),
        ("experiment", ["tracing", "--mesh", "cube"], "skull-fine"),
        ("experiment", ["tracing", "--trials", "0"], "trials 0 is outside 1 to 10000"),
        pytest.param(
            "study",
            ["--scheduler", "tcp://127.0.0.1:9"],
            "127.0.0.1",
            marks=pytest.mark.slow,  # waits ten seconds for an answer
        ),
    ],
)
def test_bad_input_gets_one_line(
    command: str, words: list[str], word: str, tmp_path, capsys
) -> None:
    try:
        code = call(
            command, [*words, "--out", str(tmp_path / "out")] if words != ["sewing"] else words
        )
        message = capsys.readouterr().err
    except OptionError as error:
        code, message = 2, str(error)
    assert code == 2
    assert word in message


def test_files_hold_nothing_of_time_and_place(tmp_path: Path) -> None:
    trial = study.grid(**GRID)[0]
    values = json.loads(study.outcome_text(trial))
    assert values["elapsed"] == values["driving"] == 0.0
    assert values["trajectory"] == []

"""From the folder of a study to tables and a report: what is missing is named, nothing is lost."""

from __future__ import annotations

import csv
import json
import math
import re
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

from app.studies.people.analysis import analyse, delete, figures
from app.studies.people.analysis.data import read
from app.words import OptionError
from tests.support.user_studies import change, drop, interrupt, make


class Text(HTMLParser):
    """The visible text of a page, and whatever it would load from elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.text, self.loads, self._hidden = "", [], False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._hidden = tag in ("style", "script")
        self.loads += [v for k, v in attrs if k in ("src", "href", "xlink:href")
                       and not (v or "").startswith("#")]  # fmt: skip

    def handle_data(self, data: str) -> None:
        self.text += "" if self._hidden else f" {data} "


def shown(folder: Path) -> Text:
    page = Text()
    page.feed((folder / "analysis/report.html").read_text("utf-8"))
    return page


def table(folder: Path, name: str) -> list[dict[str, str]]:
    with (folder / f"analysis/{name}.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study with one who stopped, one who withdrew, and files that are damaged."""
    folder = tmp_path_factory.mktemp("studies") / "whole"
    make(folder, 8, effects={("on", "time"): -30.0}, seed=3, simulated=True)
    interrupt(folder, "P02", 5)
    interrupt(folder, "P03", 2, "withdrawn")
    change(folder, "P01", 3, measures={"sal": None, "sparc": math.nan}, completed=False)
    (folder / "participants/P04/trials/006.json").write_text("{ half")
    (folder / "participants/P05/tlx.json").write_text("[]")
    (folder / "participants/P06/sitting.json").write_text("")
    (folder / "participants/P99").mkdir()
    (folder / "participants/.deleted-P7").mkdir()
    sitting = folder / "participants/P00/sitting.json"
    answers = {"experience": "=1+1", "note": "<script>alert(1)</script>"}
    sitting.write_text(json.dumps(json.loads(sitting.read_text()) | {"answers": answers}))
    assert analyse(folder) == 0
    return folder


def test_the_report_is_one_file_with_figures(whole: Path) -> None:
    page, text = shown(whole), (whole / "analysis/report.html").read_text("utf-8")
    assert page.loads == []
    assert not re.search(r"url\((?!#)", text)
    assert text.count("<svg") == 4  # the task, workload, effects, learning
    assert "tracing, time" in page.text
    assert "less with on than with off (better" in page.text


def test_it_says_who_and_what_is_missing(whole: Path) -> None:
    text = " ".join(shown(whole).text.split())
    assert "Simulated participants" in text
    assert "7 participants, 5 of them complete" in text
    assert "P02: not finished (now at: trial), 4 of 6 trials" in text
    assert "P03: withdrew, 1 of 6 trials" in text
    assert "P04, 006.json cannot be read and is left out" in text
    assert "P05, tlx.json cannot be read" in text
    assert "P06 cannot be read and is left out" in text
    assert "P99 has no sitting.json" in text
    assert "1 of smoothness, SAL in tracing, 1 of smoothness, SPARC in tracing" in text
    assert "Ended before the goal was reached: 1 trial." in text
    assert "deleted" not in text


def test_answers_are_in_the_table_of_participants_alone_and_harmless(whole: Path) -> None:
    assert "alert(1)" not in (whole / "analysis/report.html").read_text("utf-8")
    first = table(whole, "participants")[0]
    assert (first["participant"], first["answer_experience"]) == ("P00", "'=1+1")


def test_the_tables_have_what_the_files_have(whole: Path) -> None:
    rows = {(r["participant"], int(r["trial"])): r for r in table(whole, "trials")}
    files = list(whole.glob("participants/P0[0-5]/trials/*.json"))
    files += list(whole.glob("participants/P07/trials/*.json"))
    assert len(rows) == len(files) - 1  # the damaged one
    for code, trial in (("P00", 0), ("P01", 3), ("P07", 6)):
        content = json.loads((whole / f"participants/{code}/trials/{trial:03d}.json").read_text())
        row = rows[code, trial]
        assert row["training"] == str(trial == 0)
        assert row["condition"] == content["condition"]
        assert float(row["path_deviation_m"]) == content["measures"]["path_deviation"]
        assert float(row["contacts_dura"]) == trial
    assert rows["P01", 3]["sal"] == rows["P01", 3]["sparc"] == ""
    compared = {r["measure"]: r for r in table(whole, "comparisons")}
    assert compared["time"]["participants"] == "6"  # P03 has one condition only
    assert float(compared["time"]["p_holm"]) == pytest.approx(
        min(8 * float(compared["time"]["p"]), 1.0)
    )
    assert len(table(whole, "workload")) == 2 * 4  # P02, P03, P05 have none


def test_parquet_has_the_same_as_csv(whole: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    for name in ("trials", "workload", "participants", "comparisons"):
        rows = parquet.read_table(whole / f"analysis/{name}.parquet").to_pylist()
        texts = [{k: "" if v is None else str(v) for k, v in row.items()} for row in rows]
        assert texts == table(whole, name)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports without figures, which take a second each."""
    for name in ("people", "workload", "forest", "learning"):
        monkeypatch.setattr(figures, name, lambda *_: "<svg></svg>")


@pytest.mark.usefixtures("quick")
def test_one_participant_has_a_report_and_no_test(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert analyse(make(tmp_path, 1)) == 0
    text = " ".join(shown(tmp_path).text.split())
    assert "No comparison was possible" in text
    assert "one participant has both conditions" in text
    assert "No comparison was possible" in capsys.readouterr().out


@pytest.mark.usefixtures("quick")
def test_equal_values_have_a_report_and_no_test(tmp_path: Path) -> None:
    make(tmp_path, 4, repetitions=2)
    for file in tmp_path.glob("participants/*/trials/*.json"):
        content = json.loads(file.read_text())
        content["measures"] = dict.fromkeys(content["measures"], 1.0)
        file.write_text(json.dumps(content))
    analyse(tmp_path)
    text = shown(tmp_path).text
    assert "all 4 differences are 0: nothing to test" in text
    assert "all values are equal" in text


@pytest.mark.usefixtures("quick")
def test_without_the_extra_the_rest_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    make(tmp_path, 3, repetitions=2)
    for name in list(sys.modules):
        if name.split(".")[0] in ("statsmodels", "pyarrow", "pandas"):
            monkeypatch.delitem(sys.modules, name)
    for name in ("statsmodels", "pyarrow"):
        monkeypatch.setitem(sys.modules, name, None)
    assert analyse(tmp_path) == 0
    said = capsys.readouterr().out
    assert "No Parquet files: pyarrow is not installed" in said
    assert "No mixed models: statsmodels is not installed" in said
    assert "statsmodels is not installed: pip install" in shown(tmp_path).text
    assert {p.suffix for p in (tmp_path / "analysis").iterdir()} == {".csv", ".html"}
    monkeypatch.setattr(figures, "forest", _missing)
    (tmp_path / "analysis/report.html").unlink()
    assert analyse(tmp_path) == 0
    assert not (tmp_path / "analysis/report.html").exists()
    assert "No report: matplotlib" in capsys.readouterr().out


def _missing(*_: object) -> str:
    raise ImportError("No module named 'matplotlib'")


@pytest.mark.usefixtures("quick")
def test_who_is_deleted_is_nowhere_any_more(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make(tmp_path, 4, repetitions=2)
    analyse(tmp_path)
    capsys.readouterr()
    assert delete(tmp_path, "p02") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "P02: 12 files removed" in said
    assert "report.html" in said
    assert "user-study analyse" in said
    left = [p for p in tmp_path.rglob("*") if p.is_file()]
    assert left
    assert not any(b"P02" in p.read_bytes() or "P02" in str(p) for p in left)
    assert [one.code for one in read(tmp_path).people] == ["P00", "P01", "P03"]
    analyse(tmp_path)
    assert "P02" not in shown(tmp_path).text
    delete(tmp_path, "P00")
    assert "Copies elsewhere" in capsys.readouterr().out


@pytest.mark.parametrize("code", ["P9", "..", "../..", "P0/trials", ""])
def test_another_code_deletes_nothing(tmp_path: Path, code: str) -> None:
    make(tmp_path, 2, repetitions=2)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(ValueError, match=r"(?i)code|no participant"):
        delete(tmp_path, code)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_folder_that_is_no_study_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="no folder of a study"):
        analyse(tmp_path)
    make(tmp_path / "empty", 1)
    drop(tmp_path / "empty", "P00")
    with pytest.raises(OptionError, match="nobody has taken part"):
        analyse(tmp_path / "empty")

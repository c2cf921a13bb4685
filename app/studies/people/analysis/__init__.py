"""The analysis of a user study: tables, statistics, one report; and who is deleted from it."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from app.console import console, count


def analyse(folder: Path) -> int:
    """Write tables and report to the study's folder `analysis`, and print what was found.

    Returns:
        The exit code.

    Raises:
        OptionError: no folder of a study, or nobody has taken part.
        OSError: something cannot be written.
    """
    from app.studies.people.analysis import data, found, report, tables
    from app.studies.people.analysis.deletion import OUTPUT
    from app.studies.people.folder import write
    from app.words import OptionError

    out, study = console(), data.read(folder)
    if not study.people:
        raise OptionError(f"{folder}: nobody has taken part yet")
    with out.status("computing"):
        result = found.analysed(study)
    target = folder / OUTPUT
    target.mkdir(exist_ok=True)
    made = {
        "trials": tables.trials(study),
        "workload": tables.workload(study),
        "participants": tables.participants(study),
        "comparisons": tables.comparisons(result.contrasts),
    }
    written, missing = tables.write(made, target), []
    try:
        written += tables.write_parquet(made, target)
    except ImportError:
        missing.append("No Parquet files: pyarrow is not installed")
    try:
        text = report.render(result)
    except ImportError:
        missing.append("No report: matplotlib is not installed")
    else:
        write(target / "report.html", text)
        written.append(target / "report.html")
    if result.models is None:
        missing.append("No mixed models: statsmodels is not installed")
    _show(result, out)
    for what in missing:
        out.print(f"{what}: pip install 'vf-sandbox[experiments,study]'", markup=False)
    out.print(f"written to {target}: {', '.join(p.name for p in written)}", markup=False)
    return 0


def delete(folder: Path, code: str) -> int:
    """Remove a participant and what was derived from their data, and say what it was.

    Returns:
        The exit code.

    Raises:
        OptionError: no folder of a study, or no such participant.
        OSError: something cannot be removed.
    """
    from app.studies.people.analysis.deletion import remove

    out, removed = console(), remove(folder, code)
    out.print(f"{removed.code}: {count(removed.files, 'file')} removed.", markup=False)
    if removed.derived:
        out.print(
            "Removed too, as data of this participant were in them: "
            f"{', '.join(str(path) for path in removed.derived)}. "
            f"Make them again: vf-sandbox user-study analyse {folder}",
            markup=False,
            soft_wrap=True,
        )
    out.print("Copies elsewhere, and backups, are yours to delete.")
    return 0


def _show(result, out: Console) -> None:  # type: ignore[no-untyped-def]
    from app.studies.people.analysis import words

    lines = [*words.about(result.data), *words.incomplete(result.data), *result.data.problems]
    for line in lines:
        out.print(line, markup=False)
    for line in words.findings(result.contrasts):
        out.print(f"– {line}", markup=False)

"""Description of the machine for a result, statistics, and writing of results."""

from __future__ import annotations

import gc
import json
import os
import platform
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

_PACKAGES = (
    "numpy", "numba", "osqp", "pin", "coal", "trimesh", "scipy", "open3d", "libigl", "fcpw",
    "qpsolvers", "daqp", "proxsuite", "viser",
)  # fmt: skip


def machine() -> dict[str, Any]:
    """Processor, load, Python, and versions of the measured packages."""
    versions = {}
    for package in _PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load before": load,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "packages": versions,
    }


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or "unknown"


def resident() -> float | None:
    """Resident memory of this process [MB]; None if the system does not report it."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def proportional(process: int | str = "self") -> float | None:
    """Memory of a process [MB], what it shares with others by its share; None if not known."""
    try:
        lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
        return int(next(line for line in lines if line.startswith("Pss:")).split()[1]) * 1.024e-3
    except (OSError, ValueError, StopIteration):
        return None


def stolen() -> float | None:
    """For how long others had the processors of this virtual machine [s], each; None if not known.

    Only while there was something to run here; the system counts it in hundredths of a second.
    """
    try:
        words = Path("/proc/stat").read_text().split(None, 9)
        return int(words[8]) / os.sysconf("SC_CLK_TCK") / (os.cpu_count() or 1)
    except (OSError, ValueError, IndexError):
        return None


def scheduling(thread: int) -> str:
    """How a thread is scheduled: in real time, with a raised priority, or as any other."""
    try:
        if os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK != os.SCHED_OTHER:
            return f"real time, priority {os.sched_getparam(thread).sched_priority}"
        nice = os.getpriority(os.PRIO_PROCESS, thread)
    except (OSError, AttributeError):
        return "unknown"
    return f"nice {nice}" if nice else "as any other"


def percentiles(samples: ArrayLike, of: Sequence[float] = (1, 50, 99)) -> tuple[float, ...]:
    """Percentiles of a sample; NaN for an empty one."""
    values = np.asarray(samples, dtype=np.float64)
    if not len(values):
        return tuple(float("nan") for _ in of)
    return tuple(float(p) for p in np.percentile(values, of))


@contextmanager
def no_collection() -> Iterator[None]:
    """Disable Python's garbage collector, whose pauses would count as query time."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def write(folder: Path, name: str, result: dict[str, Any]) -> Path:
    """Write a result as JSON (non-finite numbers become null); returns the file."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{name}.json"
    file.write_text(json.dumps(_plain(result), indent=1, allow_nan=False) + "\n")
    return file


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value

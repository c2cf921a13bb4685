"""`bench meshes`: time from a mesh file to a fixture, of the health report, and of the repair."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from rich.console import Console

import meshes
import vf
from app.bench.tools import report
from app.bench.tools.machine import machine, resident
from app.bench.tools.settings import Meshes
from app.console import Column, count, show_table
from meshes.builtin.damage import damage

FLIPPED = 0.02  # share of the faces flipped before the repair


def run(
    options: Meshes, say: Callable[[str], None], advance: Callable[[float], None]
) -> dict[str, Any]:
    """Seconds for each step on one mesh, the best of `options.passes`."""
    about = machine()
    say(f"making {options.mesh}")
    vertices, faces = meshes.arrays(options.mesh, unit=options.unit)
    flipped = faces.copy()
    turned = np.random.default_rng(0).random(len(faces)) < FLIPPED
    flipped[turned] = flipped[turned][:, ::-1]
    with tempfile.TemporaryDirectory() as folder:
        tasks: dict[str, Callable[[], object]] = {}
        for kind in options.formats:
            path = Path(folder) / f"mesh.{kind}"
            meshes.save(path, vertices, faces, unit="mm")
            tasks[f"{kind.upper()} file to a ready fixture"] = partial(_fixture, path)
        tasks["health report without self-intersections"] = lambda: meshes.health(
            vertices, faces, examine=0
        )
        tasks[f"repair of {FLIPPED:.0%} flipped faces"] = lambda: meshes.repair(vertices, flipped)
        # Compile the kernels first: this happens once per installation.
        small = damage("flipped", meshes.arrays("cube"))
        meshes.health(*small, examine=0)
        meshes.repair(*small)
        vf.MeshFixture(vf.Surface.from_arrays(*small)).inside(np.zeros(3))
        seconds: dict[str, list[float]] = {name: [] for name in tasks}
        whole = False
        with suppress(KeyboardInterrupt):
            for k in range(options.passes):
                for i, (name, task) in enumerate(tasks.items()):
                    say(name)
                    began = perf_counter()
                    task()
                    seconds[name].append(perf_counter() - began)
                    advance((k * len(tasks) + i + 1) / (options.passes * len(tasks)))
            whole = True
    changes = meshes.repair(vertices, flipped).changes
    return {
        "what": "From a file to a guarded mesh",
        "machine": about,
        "source": f"{options.mesh}, {len(faces):,} triangles",
        "flipped": int(turned.sum()),
        "turned back": changes.flipped,
        "seconds": {name: min(times) for name, times in seconds.items() if times},
        "interrupted": not whole,
        "resident [MB]": resident(),
    }


def show(result: dict[str, Any], console: Console) -> None:
    """Print the result of `run`."""
    report.header(result, console)
    show_table(
        console,
        [Column("step", left=True), Column("s")],
        [(name, f"{seconds:.2f}") for name, seconds in result["seconds"].items()],
    )
    flipped = count(result["flipped"], "flipped face")
    console.print(f"{result['turned back']:,} of {flipped} turned back")


def _fixture(path: Path) -> vf.MeshFixture:
    """Read, build the tree, and query the side of a point: all work before the first tick."""
    vertices, faces = meshes.arrays(path, unit="mm")
    fixture = vf.MeshFixture(vf.Surface.from_arrays(vertices, faces))
    fixture.inside(vertices[0] + 1e-3)
    return fixture

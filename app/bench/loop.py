"""`bench loop`: punctuality of the control loop with a browser connected and other load."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from rich.console import Console

import meshes
from app.bench.tools import bare, report
from app.bench.tools.machine import machine, percentiles, proportional, scheduling, stolen
from app.bench.tools.settings import Loop
from app.bench.tools.watcher import NoBrowser, Watcher
from app.console import Column, show_table
from app.control.priority import raise_process_priority
from app.recording.playback import Player, build_scenes
from app.recording.read import read
from app.session import Session
from app.settings import Options
from app.view.page import Page
from app.words import Refused
from meshes.builtin import ladder

OTHER = "skull-fine"  # second mesh of the loading phase: 936,456 triangles
JOINING = 5.0  # least interval between connects and disconnects of a second client [s]
SETTLE = 2.0  # between phases [s]
LATE = 1e-3  # a tick later than this is not on time [s]
PROMPT = 1e-4  # a tick less late than this is on time to the point [s]
FIRST_TICK = 60.0  # timeout [s]
BARE = 10.0  # how long a loop that does nothing is measured, at most [s]
PATIENCE = 10.0  # for ticks that were not read yet [s]


class Tap:
    """Records start, lateness and duration of every tick of a control loop, without allocating."""

    def __init__(self, session: Session, room: int) -> None:
        # Filled now, so that its pages are mapped and do not appear as growth of memory later.
        self._rows = np.full((room, 3), -1.0)
        self.count = 0
        # The loop publishes only a summary: intercept its private clock.
        clock = session._loop.clock
        record = clock.record

        def tapped(status: Any, started: float, late: float, spent: float, overrun: bool) -> None:
            k = self.count
            if k < room:
                self._rows[k] = started, late, spent
                self.count = k + 1
            record(status, started, late, spent, overrun)

        clock.record = tapped  # type: ignore[method-assign]

    def between(self, start: float, end: float) -> NDArray[np.float64]:
        """Ticks that began between two times of `time.perf_counter`: (k, 3) start, lateness,
        duration [s].

        Waits until they have come: a page that has no time reads them later.
        """
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            if self.count and self._rows[self.count - 1, 0] >= end:
                break
            time.sleep(0.01)
        rows = self._rows[: self.count]
        first, last = np.searchsorted(rows[:, 0], (start, end))
        return rows[first:last].copy()


def run(
    options: Loop, say: Callable[[str], None], advance: Callable[[float], None]
) -> dict[str, Any]:
    """Run the phases; returns the content of `loop.json`. See `runtime.run` for the callbacks.

    Raises:
        ValueError: an unusable mesh or setting.
    """
    about = machine()
    raise_process_priority()
    say("a loop that does nothing, for comparison")
    seconds = min(options.seconds, BARE)
    nothing = summary(bare.measure(options.rate, seconds), seconds, options.rate)
    with ExitStack() as stack:
        path, unit, name = _mesh(options, stack, say)
        wanted = Options(
            mesh=path, unit=unit, rate=options.rate, rule=options.rule, guard=options.guard,
            radius=options.radius,
            port=0,
        )  # fmt: skip
        began = time.perf_counter()
        session = Session(wanted, progress=say, process=True)
        # With a margin, since loading may outlast its phase.
        room = int(options.rate * (options.seconds + SETTLE + 30.0) * (len(options.phases) + 1))
        tap = Tap(session, room)
        stack.callback(session.close)
        session.start()
        until(lambda: tap.count > 0, FIRST_TICK)
        first_tick = time.perf_counter() - began
        page = Page(session, wanted.host, 0)
        stack.callback(page.close)
        ready = time.perf_counter() - began
        browser, seen = None, "no browser asked for"
        if options.browser:
            say("opening the browser")
            try:
                browser = stack.enter_context(Watcher(page.url))
                seen = "a headless Chromium looks on (software rendering, on the same cores)"
            except NoBrowser as reason:
                seen = f"no browser: {reason}"
        place = session._loop.place
        how = "unknown" if place is None else scheduling(place[1])
        rows: list[dict[str, Any]] = []
        with suppress(KeyboardInterrupt):
            for k, phase in enumerate(options.phases):
                say(f"{phase}, {options.seconds:g} s")
                rows.append(_phase(phase, options, session, tap, browser))
                advance((k + 1) / len(options.phases))
    return {
        "what": "vf-sandbox bench loop",
        "machine": about,
        "options": asdict(options),
        "mesh": name,
        "browser": seen,
        "scheduling": how,
        "a loop that does nothing": nothing,
        "start": {"first tick [s]": first_tick, "page [s]": ready},
        "phases": rows,
        "interrupted": len(rows) < len(options.phases),
    }


def _mesh(
    options: Loop, stack: ExitStack, say: Callable[[str], None]
) -> tuple[str, str | None, str]:
    """Mesh, unit and description; the largest mesh of the ladder is written to a file first."""
    if options.mesh is not None:
        return options.mesh, options.unit, options.mesh
    shape = ladder.source()
    rungs = ladder.rungs(shape, (ladder.SIZES[-1],), say)
    size, (vertices, faces) = next(iter(rungs.items()))
    folder = stack.enter_context(tempfile.TemporaryDirectory())
    file = Path(folder) / "million.ply"
    trimesh.Trimesh(vertices * 1e3, faces, process=False).export(file)
    return str(file), "mm", f"{size:,} triangles, binary PLY, {shape.name}"


def _phase(
    phase: str, options: Loop, session: Session, tap: Tap, browser: Watcher | None
) -> dict[str, Any]:
    session.reset()
    session.set_autopilot(phase != "idle")
    done = {"loads": 0, "reports": 0, "joins": 0, "recorded": 0, "replays": 0}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        if phase == "replaying":
            session.record(folder / "some.vfrec")
        time.sleep(min(SETTLE, options.seconds))
        if phase == "replaying":
            session.stop_recording()
        stop = threading.Event()
        jobs: dict[str, tuple[Callable[..., None], Any]] = {
            "loading": (_load, session),
            "examining": (_examine, session),
            "recording": (_record, (session, folder)),
            "replaying": (_replay, folder),
        }
        if browser is not None:
            jobs["joining"] = (_join, browser)
        work: list[threading.Thread] = []
        if phase in jobs:
            job, on = jobs[phase]
            work.append(threading.Thread(target=job, args=(on, stop, done), name=phase))
        frames = _frames(browser) if phase != "joining" else None
        memory = _memory(session)
        processor, began = time.process_time(), time.perf_counter()
        overruns, waited = session.latest().stats.overruns, _waited(session)
        taken = stolen()
        for thread in work:
            thread.start()
        time.sleep(options.seconds)
        elapsed = time.perf_counter() - began
        busy = (time.process_time() - processor) / elapsed
        waited_after, taken_after = _waited(session), stolen()
        after = _memory(session)
        ticks = tap.between(began, began + elapsed)
        row = summary(ticks, elapsed, options.rate)
        stop.set()
        for thread in work:
            thread.join()
        drawn = _frames(browser) if phase != "joining" else None
        return {
            "phase": phase,
            **row,
            "overruns": session.latest().stats.overruns - overruns,
            "cpu": busy,
            # Share of the phase in which the control thread was runnable without a core: the load
            # of other threads and processes, also the browser's.
            "no core": share(waited, waited_after, elapsed),
            # Share of the processors that the host gave to others meanwhile.
            "stolen": share(taken, taken_after, elapsed),
            "memory [MB]": {"start": memory, "end": after},
            "frames/s": None if frames is None or drawn is None else (drawn - frames) / elapsed,
            **done,
        }


def share(before: float | None, after: float | None, elapsed: float) -> float | None:
    """Share of a time [s] in which a clock went on [s]; None: there is none."""
    return None if before is None or after is None else (after - before) / elapsed


def _memory(session: Session) -> dict[str, float | None]:
    """Memory of the page's process and of the control process [MB]."""
    place = session._loop.place
    return {
        "page": proportional(),
        "control": None if place is None else proportional(place[0]),
    }


def summary(ticks: NDArray[np.float64], elapsed: float, rate: float) -> dict[str, Any]:
    """Punctuality of ticks (k, 3) of start, lateness, duration [s] over `elapsed` [s].

    The loop does not make up for lost time: ticks that are missing after a stall count as late.
    """
    starts, late, spent = ticks[:, 0], ticks[:, 1], ticks[:, 2]
    due = max(round(elapsed * rate), len(ticks), 1)
    names = ("p50", "p99", "p99.9")
    of = (50.0, 99.0, 99.9)
    gaps = np.diff(starts)
    return {
        "ticks": len(ticks),
        "rate [Hz]": (len(ticks) - 1) / float(starts[-1] - starts[0]) if len(ticks) > 1 else 0.0,
        "late [us]": dict(zip(names, percentiles(late * 1e6, of), strict=True)),
        "tick [us]": dict(zip(names, percentiles(spent * 1e6, of), strict=True)),
        "punctual": float((late < LATE).sum()) / due,
        "prompt": float((late < PROMPT).sum()) / due,
        "longest stall [ms]": float(gaps.max()) * 1e3 if len(gaps) else float("nan"),
    }


def show(result: dict[str, Any], console: Console) -> None:
    """Print the result as a table."""
    report.header(result, console)
    console.print(
        f"mesh: {result['mesh']}; {result['browser']}; control thread: {result['scheduling']}"
    )
    start = result["start"]
    console.print(
        f"from the start of the session to the first tick {start['first tick [s]']:.1f} s, "
        f"to the page {start['page [s]']:.1f} s"
    )
    nothing = result["a loop that does nothing"]
    console.print(
        f"a loop that does nothing, with the same priority, before the rest: "
        f"{100 * nothing['punctual']:.3f} % < 1 ms late, {100 * nothing['prompt']:.3f} % < 0.1 ms, "
        f"longest stall {nothing['longest stall [ms]']:.2f} ms"
    )
    names = (
        "phase", "ticks", "rate [Hz]", "late p50 [µs]", "late p99", "late p99.9", "< 1 ms late",
        "< 0.1 ms", "longest stall [ms]", "overruns", "tick p50 [µs]", "tick p99", "page's CPU",
        "no core", "stolen", "memory, page + control [MB]", "frames/s",
    )  # fmt: skip
    rows = []
    for row in result["phases"]:
        late, tick, memory = row["late [us]"], row["tick [us]"], row["memory [MB]"]
        cells = (
            row["phase"],
            f"{row['ticks']:,}",
            f"{row['rate [Hz]']:.1f}",
            *(f"{late[k]:.0f}" for k in ("p50", "p99", "p99.9")),
            f"{100 * row['punctual']:.3f} %",
            f"{100 * row['prompt']:.3f} %",
            f"{row['longest stall [ms]']:.2f}",
            str(row["overruns"]),
            f"{tick['p50']:.0f}",
            f"{tick['p99']:.0f}",
            f"{100 * row['cpu']:.0f} %",
            *("–" if row[k] is None else f"{100 * row[k]:.2f} %" for k in ("no core", "stolen")),
            " → ".join(_both(memory[k]) for k in ("start", "end")),
            f"{row['frames/s']:.1f}" if row["frames/s"] is not None else "–",
        )
        rows.append(cells)
    show_table(
        console,
        [Column(name, left=name == "phase") for name in names],
        rows,
        title="Control loop, by phase",
    )


def _both(memory: dict[str, float | None]) -> str:
    page, control = memory["page"], memory["control"]
    return "–" if page is None or control is None else f"{page:.0f} + {control:.0f}"


def _load(session: Session, stop: threading.Event, done: dict[str, int]) -> None:
    """Change the mesh to another one and back until `stop`; end with the original one."""
    mesh, unit = session.options.mesh, session.options.unit
    while not stop.is_set():
        for name, its in ((OTHER, None), (mesh, unit)):
            try:
                session.change(mesh=name, unit=its)
            except Refused:
                return
            session.set_autopilot(True)
            done["loads"] += 1


def _examine(session: Session, stop: threading.Event, done: dict[str, int]) -> None:
    """Compute the health report of the mesh repeatedly, as its button on the page does."""
    while not stop.is_set():
        meshes.health(session.scene.surface)
        done["reports"] += 1


def _record(on: tuple[Session, Path], stop: threading.Event, done: dict[str, int]) -> None:
    """Record until `stop`."""
    session, folder = on
    session.record(folder / "run.vfrec")
    stop.wait()
    done["recorded"] += session.stop_recording().rows


def _replay(folder: Path, stop: threading.Event, done: dict[str, int]) -> None:
    """Load a recording with its scene repeatedly, as the page does before it shows it."""
    while not stop.is_set():
        recording = read(folder / "some.vfrec")
        player = Player(recording, build_scenes(recording, 1000))
        for row in range(0, len(player), 100):
            player.moment(row)
        done["replays"] += 1


def _join(browser: Watcher, stop: threading.Event, done: dict[str, int]) -> None:
    """Connect and disconnect a second client repeatedly."""
    while not stop.is_set():
        try:
            done["joins"] += 1  # counted at the start: the first frame is slow in software
            browser.request("join")
            stop.wait(JOINING)
            browser.request("leave")
        except NoBrowser:
            return
        stop.wait(JOINING)


def _waited(session: Session) -> float | None:
    """Time for which the control thread was runnable without a core [s]; None if not Linux."""
    place = session._loop.place
    if place is None:
        return None
    process, thread = place
    try:
        return int(Path(f"/proc/{process}/task/{thread}/schedstat").read_text().split()[1]) * 1e-9
    except (OSError, ValueError, IndexError):
        return None


def _frames(browser: Watcher | None) -> int | None:
    if browser is None:
        return None
    try:
        return int(browser.request("frames")["frames"])
    except NoBrowser:
        return None


def until(condition: Callable[[], bool], patience: float) -> None:
    """Wait for a condition of the control thread.

    Raises:
        ValueError: it was not met within `patience` [s].
    """
    deadline = time.monotonic() + patience
    while not condition():
        if time.monotonic() > deadline:
            raise ValueError("the control thread did not tick")
        time.sleep(1e-3)

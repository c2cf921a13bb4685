"""Builds scenes and reads mesh files in a separate process.

Mesh readers, Boolean operations and decimation hold the interpreter lock, for up to a second with a
million triangles, which would stop the control thread. The result is received through a pipe, with
its arrays read in place and without the lock.

A small file can require any amount of work. So processor time and memory of the process are limited
according to the size of its file, the system kills it first when memory runs out, and it can be
stopped.

Run as a module, this file is that process: it reads a request from standard input and answers on
standard output with frames, each a pickle and its arrays.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import os
import pickle
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np

import meshes
from app import choices
from app.scene import scene as scenes
from app.scene import structures
from app.scene.scene import Progress, Scene
from app.settings import Options
from meshes.builtin import shapes
from robots import Arm

LIGHT = 500_000  # largest file that is read and indexed in milliseconds [byte]
MOST_LIGHT = 3  # files that are read here; more take longer than a process starts
_LIGHT_KINDS = (".stl", ".ply", ".off")  # uncompressed formats without references
_STOPPED = "stopped: nothing is changed"
_PIPE = 1 << 20  # size of the pipe's buffer [byte]
_LENGTH = 8  # of a number in the stream [byte]
_PATIENCE = 10.0  # limit of elapsed time, in multiples of the limit of processor time


class Ended(ValueError):
    """The process ended without a result; the message says why."""


class Stopped(ValueError):
    """The process was stopped by `Stop`."""


@dataclass(frozen=True)
class Allowance:
    """Limits of a process: ``seconds`` of processor time, ``memory`` [byte]."""

    seconds: float
    memory: float


def allowance(*names: str) -> Allowance:
    """Several times the need of any mesh files of this size, or of any meshes of the catalogue.

    The memory is at most three quarters of the machine's available memory.
    """
    seconds, size = 0.0, 0
    for name in names:
        if name in meshes.catalogue() or name in choices.SETS:
            seconds += 300.0
            continue
        seconds += 60.0
        with contextlib.suppress(OSError, ValueError):  # reading the file raises the error
            size += Path(name).stat().st_size
    return Allowance(seconds + 2e-6 * size, min(3e9 + 20.0 * size, 0.75 * _available_memory()))


class Stop:
    """Kills a process, now or as soon as it starts. Thread-safe; may be called repeatedly."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self.asked = False

    def __call__(self) -> None:
        with self._lock:
            self.asked = True
            if self._process is not None:
                self._process.kill()

    def watch(self, process: subprocess.Popen[bytes]) -> None:
        """Set the process to kill; call `forget` before it is waited for."""
        with self._lock:
            self._process = process
            if self.asked:
                process.kill()

    def forget(self) -> None:
        """Clear the process: once it has been waited for, its id may be reused."""
        with self._lock:
            self._process = None


def build(
    options: Options,
    version: int,
    arm: Arm,
    progress: Progress | None = None,
    stop: Stop | None = None,
) -> Scene:
    """`scene.build` in a separate process, or in this one for light meshes.

    Args:
        arm: the scene's arm, for the view's thread; of the name in `options`.
        progress: called with a short text before each step.
        stop: stops the work.

    Raises:
        ValueError: what `scene.build` raises, `Ended` and `Stopped`.
    """
    work = functools.partial(scenes.build, options, version, warm=False)
    return build_scene(work, structures.files_of(options), arm, progress, stop)


def build_scene(
    work: Callable[..., Scene],
    files: Sequence[str],
    arm: Arm,
    progress: Progress | None = None,
    stop: Stop | None = None,
) -> Scene:
    """The scene that ``work(progress=…)`` builds, by `run`, or in this process for light meshes.

    Args:
        files: those that it reads, as `structures.files_of` names them.

    Raises:
        ValueError: what the work raises, `Ended` and `Stopped`.
    """
    if len(files) > MOST_LIGHT or not all(map(light, files)):
        scene: Scene = run(work, allowance(*files), progress, stop, arm)
        return scene
    scene = work(progress=progress)
    if stop is not None and stop.asked:
        raise Stopped(_STOPPED)
    return scene


def run(
    work: Callable[..., Any],
    allowed: Allowance,
    progress: Progress | None = None,
    stop: Stop | None = None,
    arm: Arm | None = None,
) -> Any:
    """The result of ``work(progress=…)``, computed in a separate process.

    Args:
        work: a function of a module, or a `functools.partial` of one.
        progress: called with a short text before each step.
        stop: stops the work.
        arm: replaces every arm in the result.

    Raises:
        Ended: a limit was exceeded, or the process died.
        Stopped: `stop` was called.
        Exception: what the work raised, as a ValueError if it cannot be pickled.
    """
    say = progress or (lambda _text: None)
    stop = stop or Stop()
    say("starting a process for the mesh")
    # Outside the terminal's process group: Ctrl-C goes to the session, which ends this process.
    process = subprocess.Popen(
        [sys.executable, "-m", "app.scene.worker"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    stop.watch(process)
    late = Stop()
    late.watch(process)
    timer = threading.Timer(_PATIENCE * allowed.seconds, late)
    timer.daemon = True
    timer.start()
    try:
        with contextlib.suppress(OSError, AttributeError):
            fcntl.fcntl(process.stdout, fcntl.F_SETPIPE_SZ, _PIPE)
        with contextlib.suppress(BrokenPipeError):
            pickle.dump((work, allowed), process.stdin)
            process.stdin.close()
        while True:
            kind, content = _receive(process.stdout, arm)
            if kind == "say":
                say(content)
            elif kind == "failed":
                raise content
            else:
                return content
    except EOFError:
        stop.forget()
        late.forget()
        code = process.wait()
        if stop.asked:
            raise Stopped(_STOPPED) from None
        raise Ended(_reason(code, allowed, late.asked)) from None
    finally:
        timer.cancel()
        stop.forget()
        late.forget()
        process.kill()
        process.wait()
        process.stdout.close()


def _reason(code: int, allowed: Allowance, late: bool) -> str:
    """Why the process ended without a result."""
    if late:
        return (
            f"the work on the mesh was not done after {_PATIENCE * allowed.seconds:.0f} s: "
            "is the machine busy, or the file on a drive that does not answer?"
        )
    if code == -signal.SIGXCPU:
        return (
            f"the work on the mesh took more than {allowed.seconds:.0f} s of processor time, many "
            "times what a mesh file of this size needs: is it what it says it is?"
        )
    ending = f"signal {signal.Signals(-code).name}" if code < 0 else f"code {code}"
    return (
        f"the process that works on the mesh ended ({ending}): is there memory for it? "
        f"It may have {allowed.memory / 1e9:.2g} GB"
    )


def light(mesh: str) -> bool:
    """Whether a mesh is made or read faster than a process starts, in a few milliseconds."""
    entry = meshes.catalogue().get(mesh)
    if mesh in choices.SETS:
        return False
    if entry is not None:
        return entry.make.__module__ == shapes.__name__
    path = Path(mesh)
    try:
        return path.stat().st_size <= LIGHT and path.suffix.lower() in _LIGHT_KINDS
    except (OSError, ValueError):
        return True  # reading the file raises the error


class _Pickler(pickle.Pickler):
    """Omits arms, which cannot be pickled; the receiver inserts its own."""

    def persistent_id(self, obj: Any) -> str | None:
        return "arm" if isinstance(obj, Arm) else None


class _Unpickler(pickle.Unpickler):
    def __init__(self, data: bytes, arm: Arm | None, buffers: list[memoryview]) -> None:
        super().__init__(BytesIO(data), buffers=buffers)
        self._arm = arm

    def persistent_load(self, _pid: str) -> Arm | None:
        return self._arm


def _send(stream: IO[bytes], kind: str, content: Any) -> None:
    """Send a frame: length of the pickle, number and lengths of the arrays; pickle; arrays."""
    arrays: list[pickle.PickleBuffer] = []
    data = BytesIO()
    _Pickler(data, protocol=5, buffer_callback=arrays.append).dump((kind, content))
    raw = [array.raw() for array in arrays]
    for number in (len(data.getvalue()), len(raw), *(part.nbytes for part in raw)):
        stream.write(number.to_bytes(_LENGTH, "little"))
    stream.write(data.getvalue())
    for part in raw:
        stream.write(part)
    stream.flush()


def _receive(stream: IO[bytes], arm: Arm | None) -> tuple[str, Any]:
    """The next frame's content, with read-only arrays.

    Raises:
        EOFError: the stream ended.
    """

    def number() -> int:
        return int.from_bytes(_exactly(stream, _LENGTH), "little")

    length, count = number(), number()
    lengths = [number() for _ in range(count)]
    data = bytes(_exactly(stream, length))
    arrays = [_exactly(stream, size).toreadonly() for size in lengths]
    kind, content = _Unpickler(data, arm, arrays).load()
    return str(kind), content


def _exactly(stream: IO[bytes], size: int) -> memoryview:
    # numpy allocates with huge pages, which are faster to fill and to free.
    buffer = np.empty(size, dtype=np.uint8).data
    if stream.readinto(buffer) != size:  # type: ignore[attr-defined]
        raise EOFError
    return buffer


def _available_memory() -> float:
    """Available memory of the machine, or of its container [byte]; inf: unknown."""
    spare = np.inf
    with contextlib.suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/meminfo").read_text().splitlines()
        found = next(line for line in lines if line.startswith("MemAvailable:"))
        spare = 1024.0 * int(found.split()[1])
    with contextlib.suppress(OSError, ValueError):  # a container may have less: "max" if not
        group = Path("/sys/fs/cgroup")
        limit, used = (int((group / f"memory.{k}").read_text()) for k in ("max", "current"))
        spare = min(spare, float(max(limit - used, 0)))
    return spare


def _limit(allowed: Allowance) -> None:
    """Apply the limits to this process, as far as the system supports them."""
    seconds = int(allowed.seconds) + 1 + int(sum(os.times()[:2]))
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    with contextlib.suppress(OSError, ValueError):
        # Libraries have reserved address space that they do not use: add what is mapped already.
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        if np.isfinite(allowed.memory):
            limit = pages * resource.getpagesize() + int(allowed.memory)
            resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")
    # No core dump when a limit is exceeded.
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _main() -> None:
    os.nice(max(-os.nice(0), 0))  # drop the raised priority of the session
    # Output of libraries goes to stderr, not between the frames.
    stream = os.fdopen(os.dup(sys.stdout.fileno()), "wb", buffering=_PIPE)
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    try:
        work, allowed = pickle.load(sys.stdin.buffer)
    except (EOFError, pickle.UnpicklingError):
        os._exit(1)  # the parent ended before it sent the work
    _limit(allowed)
    try:
        try:
            result = work(progress=lambda text: _send(stream, "say", text))
        except BrokenPipeError:
            raise
        except Exception as error:
            if _out_of_memory(error):
                error = Ended(
                    f"the work on the mesh needs more than the {allowed.memory / 1e9:.2g} GB of "
                    "memory that a mesh file of this size may have"
                )
            _send(stream, "failed", _picklable(error))
        else:
            _send(stream, "done", result)
    except BrokenPipeError:
        os._exit(1)  # the parent ended


def _out_of_memory(error: BaseException | None) -> bool:
    """Whether an error was caused by lack of memory.

    A reader may have converted it into another error; compiled code that returns without setting an
    error gives a SystemError.
    """
    while error is not None:
        if isinstance(error, MemoryError | SystemError):
            return True
        error = error.__cause__ or error.__context__
    return False


def _picklable(error: Exception) -> Exception:
    """The error without its causes if it can be pickled, else a ValueError with its message."""
    try:
        copy = pickle.loads(pickle.dumps(error))
    except Exception:
        return ValueError(str(error))
    return copy if str(copy) == str(error) else ValueError(str(error))


if __name__ == "__main__":
    # Imported, so that pickled classes belong to `app.scene.worker`, not to `__main__`.
    from app.scene.worker import _main as _named

    _named()

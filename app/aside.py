"""Scenes built in a process of their own, so that nothing in it holds up the control loop.

Readers, Boolean operations and decimation keep Python's interpreter to themselves for as long as
they work, up to a second for a million triangles; in this process that would be as long a pause of
the tool. The finished scene comes back through a pipe: its arrays are read straight into place,
which lets other threads run all the while.

Run as a module, this file is that process: it reads a request from standard input and answers on
standard output with frames, each a pickle and the arrays that belong to it.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import pickle
import signal
import subprocess
import sys
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np

import meshes
from app import scene as scenes
from app.scene import Progress, Scene
from app.settings import Options
from meshes import shapes
from robots import Arm

LIGHT = 500_000  # [byte] of a file that is read and indexed in milliseconds
_LIGHT_KINDS = (".stl", ".ply", ".off")  # that cannot be larger than they look
_PIPE = 1 << 20  # [byte]
_LENGTH = 8  # [byte] of a number in the stream


class Ended(ValueError):
    """The process that builds scenes ended without an answer; the message says how."""


def build(options: Options, version: int, arm: Arm, progress: Progress | None = None) -> Scene:
    """`scene.build` without a pause for any other thread; simple shapes are made right here.

    Args:
        arm: the scene's arm, for the view's thread; of the name in `options`.
        progress: called with a few words before each step.

    Raises:
        ValueError: what `scene.build` raises, and `Ended`.
    """
    if light(options):
        return scenes.build(options, version, progress)
    say = progress or (lambda _text: None)
    say("starting a process for the mesh")
    # Not in the terminal's process group: an interrupt is for the session, which ends this process.
    process = subprocess.Popen(
        [sys.executable, "-m", "app.aside"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        with contextlib.suppress(OSError, AttributeError):
            fcntl.fcntl(process.stdout, fcntl.F_SETPIPE_SZ, _PIPE)
        with contextlib.suppress(BrokenPipeError):
            pickle.dump((options, version), process.stdin)
            process.stdin.close()
        while True:
            kind, content = _receive(process.stdout, arm)
            if kind == "say":
                say(content)
            elif kind == "failed":
                raise content
            else:
                scene: Scene = content
                return scene
    except EOFError:
        raise Ended(
            f"the process that builds the scene ended ({_ending(process.wait())}): "
            "is there memory for this mesh?"
        ) from None
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def light(options: Options) -> bool:
    """Whether a scene is built in a few milliseconds, less than a process takes to start."""
    entry = meshes.catalogue().get(options.mesh)
    if entry is not None:
        return entry.make.__module__ == shapes.__name__
    path = Path(options.mesh)
    try:
        return path.stat().st_size <= LIGHT and path.suffix.lower() in _LIGHT_KINDS
    except (OSError, ValueError):
        return True  # to be refused with the reason


class _Pickler(pickle.Pickler):
    """Leaves arms out: they are bound to this process, and the other side has its own."""

    def persistent_id(self, obj: Any) -> str | None:
        return "arm" if isinstance(obj, Arm) else None


class _Unpickler(pickle.Unpickler):
    def __init__(self, data: bytes, arm: Arm, buffers: list[memoryview]) -> None:
        super().__init__(BytesIO(data), buffers=buffers)
        self._arm = arm

    def persistent_load(self, _pid: str) -> Arm:
        return self._arm


def _send(stream: IO[bytes], kind: str, content: Any) -> None:
    """One frame: length of the pickle, number and lengths of the arrays; pickle; arrays."""
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


def _receive(stream: IO[bytes], arm: Arm) -> tuple[str, Any]:
    """The next frame's content, arrays read-only. EOFError where there is none."""

    def number() -> int:
        return int.from_bytes(_exactly(stream, _LENGTH), "little")

    length, count = number(), number()
    lengths = [number() for _ in range(count)]
    data = bytes(_exactly(stream, length))
    arrays = [_exactly(stream, size).toreadonly() for size in lengths]
    kind, content = _Unpickler(data, arm, arrays).load()
    return str(kind), content


def _exactly(stream: IO[bytes], size: int) -> memoryview:
    # numpy asks for large pages, which are as quick to fill as to give back.
    buffer = np.empty(size, dtype=np.uint8).data
    if stream.readinto(buffer) != size:  # type: ignore[attr-defined]
        raise EOFError
    return buffer


def _ending(code: int) -> str:
    return f"signal {signal.Signals(-code).name}" if code < 0 else f"code {code}"


def _main() -> None:
    os.nice(max(-os.nice(0), 0))  # what the session has of priority is for the session
    # What libraries print must not get between the frames.
    stream = os.fdopen(os.dup(sys.stdout.fileno()), "wb", buffering=_PIPE)
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    options, version = pickle.load(sys.stdin.buffer)
    try:
        try:
            scene = scenes.build(
                options, version, lambda text: _send(stream, "say", text), warm=False
            )
        except BrokenPipeError:
            raise
        except Exception as error:
            _send(stream, "failed", _portable(error))
        else:
            _send(stream, "scene", scene)
    except BrokenPipeError:
        os._exit(1)  # the session was ended: there is nobody to build for


def _portable(error: Exception) -> Exception:
    """The error itself, without what led to it, if it survives the way; else a ValueError."""
    try:
        copy = pickle.loads(pickle.dumps(error))
    except Exception:
        return ValueError(str(error))
    return copy if str(copy) == str(error) else ValueError(str(error))


if __name__ == "__main__":
    _main()

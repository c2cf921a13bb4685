"""Whether an installed wheel is whole: run it with the environment's own Python, in any folder.

    python -P .ci/smoke.py WHEEL CHECKOUT

The wheel has all that git knows of the packages; the command says its version, lists meshes and
opens a page that answers; the library answers a query; the examples run.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import urllib.request
import zipfile
from pathlib import Path

import vf

PACKAGES = ("app", "vf", "robots", "meshes")


def main(wheel: Path, checkout: Path) -> None:
    tracked = subprocess.run(
        ["git", "-C", str(checkout), "ls-files", *PACKAGES],
        check=True, capture_output=True, text=True,
    ).stdout.split()  # fmt: skip
    packed = zipfile.ZipFile(wheel).namelist()
    code = [name for name in packed if ".dist-info/" not in name]
    assert tracked
    assert sorted(code) == sorted(tracked), sorted(set(code) ^ set(tracked))
    assert any(name.endswith("LICENSE") for name in packed)
    assert checkout not in Path(vf.__file__).resolve().parents, "the checkout's vf, not the wheel's"

    command = str(Path(sys.executable).with_name("vf-sandbox"))
    said = subprocess.run([command, "--version"], check=True, capture_output=True, text=True).stdout
    assert said == f"vf-sandbox {vf.__version__}\n", said
    subprocess.run([command, "mesh", "list"], check=True)

    surface = vf.Surface.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    planes = vf.certified_planes(surface, [0.2, 0.2, 0.1], radius=0.2, standoff=1e-3)
    assert len(planes) == 1
    assert abs(planes.offsets[0] - 1e-3) < 1e-9

    assert b"<html" in page_of([command, "--mesh", "cube", "--robot", "point", "--port", "0"])
    for example in sorted((checkout / "docs/examples").glob("*.py")):
        print(example.name, flush=True)
        subprocess.run([sys.executable, "-P", str(example)], check=True)


def page_of(command: list[str]) -> bytes:
    """What the page answers that a command opens; the command ends well when interrupted."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            address = next(
                found[1] for line in process.stdout if (found := re.search(r"Open (http\S+)", line))
            )
            with urllib.request.urlopen(address, timeout=60) as answer:
                content = bytes(answer.read())
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=60) == 0
        finally:
            process.kill()
    return content


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]).resolve())
    print("the installed wheel works")

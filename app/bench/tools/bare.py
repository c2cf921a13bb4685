"""A loop that waits for its deadlines and does nothing: how punctual the machine lets a loop be.

It runs in a process of its own, with the priority and the waiting of the control loop. What is late
there no control loop on that machine can do anything about.
"""

from __future__ import annotations

import subprocess
import sys
import time
from io import BytesIO

import numpy as np
from numpy.typing import NDArray

from app.control.loop import SPIN, request_realtime


def measure(rate: float, seconds: float) -> NDArray[np.float64]:
    """Ticks at `rate` [Hz] for so long [s]: (k, 3) start, lateness, duration [s].

    Raises:
        subprocess.CalledProcessError: the process failed.
    """
    command = [sys.executable, "-m", "app.bench.tools.bare", str(rate), str(seconds)]
    return np.load(BytesIO(subprocess.run(command, capture_output=True, check=True).stdout))


def _run(rate: float, seconds: float) -> NDArray[np.float64]:
    request_realtime()
    dt = 1.0 / rate
    rows = np.zeros((round(seconds * rate), 3))
    now = time.perf_counter
    spin = min(SPIN, 0.1 * dt)
    count = 0
    deadline = now() + dt
    end = deadline + seconds
    while count < len(rows) and deadline < end:
        pause = deadline - spin - now()
        if pause > 0.0:
            time.sleep(pause)
        started = now()
        while started < deadline:
            started = now()
        rows[count, 0] = started
        rows[count, 1] = started - deadline
        count += 1
        # As the control loop does: what a stall took is not made up for.
        deadline = max(deadline + dt, now())
    return rows[:count]


if __name__ == "__main__":
    np.save(sys.stdout.buffer, _run(float(sys.argv[1]), float(sys.argv[2])))

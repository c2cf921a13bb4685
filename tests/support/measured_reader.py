"""A process of its own that reads mesh files and says what that took: a line in, a line out.

tracemalloc must not be used beside other threads: before Python 3.12.9, its stopping crashes any
thread that allocates without the interpreter lock, as kernels do (python/cpython#128679).
"""

from __future__ import annotations

import json
import sys
import time
import tracemalloc

import meshes


def main() -> None:
    for line in sys.stdin:
        reason = None
        began = time.process_time()  # whatever else the machine does meanwhile
        tracemalloc.start()
        try:
            meshes.load(json.loads(line), unit="cm")
        except meshes.MeshError as error:
            reason = str(error)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        print(json.dumps([reason, peak, time.process_time() - began]), flush=True)


if __name__ == "__main__":
    main()

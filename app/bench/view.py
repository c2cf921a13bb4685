"""`bench view`: latency from a drag to its display on the page, and the page's frame rate.

The browser runs in a separate process, `-m app.bench.view URL`, so that driving it does not load
the measured interpreter. It records the messages to and from viser's worker, so that both ends of a
delay are taken from the page's clock.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.bench.tools.settings import View
from app.bench.tools.watcher import WINDOW, Watcher, answer, browse

RATIO = 1.0  # device pixels per CSS pixel
PAUSE = 0.8  # between two drag events, until the tool is at rest and drawn in software [s]
SETTLE = 3.0  # from the opening of the page to the measurement [s]
SHAFT = 0.88  # position on the gizmo's arrow at which it is dragged, as a share of its length
MOVE = 6.0  # motion of the mouse along the arrow for each drag event [px]

_HOOK = """(() => {
  const log = window.vf = {pointer: 0, sent: [], moved: [], drawn: []};
  const event = e => { log.pointer = e.timeStamp; };
  addEventListener('pointermove', event, true);
  const Native = window.Worker;
  window.Worker = class extends Native {
    constructor(...all) {
      super(...all);
      this.addEventListener('message', e => {
        if (e.data.type !== 'message_batch') return;
        if (!e.data.messages.some(m => m.type === 'SetPositionMessage' && m.name === '/tool/dot'))
          return;
        const now = performance.now();
        log.moved.push(now);
        // The frame after the next one begins when the one that shows the move is done.
        requestAnimationFrame(() => requestAnimationFrame(() =>
          log.drawn.push([now, performance.now()])));
      });
    }
    postMessage(data, ...rest) {
      if (data.type === 'send' && data.message.type === 'TransformControlsUpdateMessage')
        log.sent.push([log.pointer, performance.now()]);
      super.postMessage(data, ...rest);
    }
  };
})()"""


# Renderer, size of the canvas (viser reduces it on slow machines), and frames drawn so far.
_PICTURE = """(() => {
  const canvas = document.querySelector('canvas[data-engine]'), gl = canvas.getContext('webgl2');
  const named = gl.getExtension('WEBGL_debug_renderer_info');
  return {
    canvas: [canvas.width, canvas.height],
    css: [canvas.clientWidth, canvas.clientHeight],
    renderer: gl.getParameter(named ? named.UNMASKED_RENDERER_WEBGL : gl.RENDERER),
    smoothed: gl.getContextAttributes().antialias,
    pictures: window.__viserTestpoints.rendererInfo.render.frame,
  };
})()"""


class Dragger(Watcher):
    """Starts this module as a process and communicates with it."""

    def __init__(self, url: str) -> None:
        """Open the page; raises as `Watcher` does."""
        super().__init__(url, "app.bench.view")

    def ask(self, what: str, **more: Any) -> dict[str, Any]:
        """Send a request and wait for the answer."""
        return self.request(json.dumps({"do": what, **more}))


def run(
    options: View, say: Callable[[str], None], advance: Callable[[float], None]
) -> dict[str, Any]:
    """Drag, then run the autopilot; returns the content of `view.json`.

    Raises:
        NoBrowser: no browser is available.
        ValueError: an unusable mesh.
    """
    from app.bench.loop import Tap, summary
    from app.bench.tools.machine import machine, percentiles
    from app.control.priority import raise_process_priority
    from app.session import Session
    from app.settings import Options
    from app.view.page import Page

    about = machine()
    raise_process_priority()
    with ExitStack() as stack:
        wanted = Options(mesh=options.mesh, rate=options.rate, port=0)
        session = Session(wanted, progress=say, process=True)
        # A slow browser may need several seconds for each drag.
        tap = Tap(session, int(options.rate * (options.seconds + 5.0 * options.drags + 120.0)))
        stack.callback(session.close)
        session.start()
        page = Page(session, "127.0.0.1", 0)
        stack.callback(page.close)
        say("opening the browser")
        dragger = stack.enter_context(Dragger(page.url))
        time.sleep(SETTLE)
        say(f"{options.drags} drag events")
        began = time.perf_counter()
        p, step = _arrow(page, dragger.ask("box"))
        dragger.ask("drag", at=p.tolist(), by=step.tolist(), count=options.drags)
        ended = time.perf_counter()
        dragging = summary(tap.between(began, ended), ended - began, options.rate)
        delays = delays_of(dragger.ask("log"))
        advance(0.5)
        say(f"autopilot, {options.seconds:g} s")
        session.reset()
        session.set_autopilot(True)
        time.sleep(SETTLE)
        began = time.perf_counter()
        before, seen = len(dragger.ask("log")["moved"]), dragger.ask("picture")
        time.sleep(options.seconds)
        elapsed = time.perf_counter() - began
        after, picture = len(dragger.ask("log")["moved"]), dragger.ask("picture")
        flying = summary(tap.between(began, began + elapsed), elapsed, options.rate)
        advance(1.0)
        of = (50.0, 90.0)
        return {
            "what": "vf-sandbox bench view",
            "machine": about,
            "options": asdict(options),
            "triangles": len(session.scene.surface.faces),
            "drags": len(delays),
            "input to message [ms]": percentiles(delays[:, 0], of),
            "message to moved tool [ms]": percentiles(delays[:, 1], of),
            "input to moved tool [ms]": percentiles(delays[:, :2].sum(axis=1), of),
            "input to picture [ms]": percentiles(delays[:, 2], of),
            "updates/s": (after - before) / elapsed,
            "pictures/s": (picture["pictures"] - seen["pictures"]) / elapsed,
            "window": {**WINDOW, "ratio": RATIO, **picture},
            "loop while dragging": dragging,
            "loop on autopilot": flying,
        }


def delays_of(log: dict[str, Any]) -> NDArray[np.float64]:
    """Delays of the drags that moved the tool: (k, 3) input to message, to tool, input to picture.

    Args:
        log: times in the page [ms]: "sent", pairs of input and message; "moved", arrivals of the
            tool's position; "drawn", pairs of such an arrival and the end of the next frame.

    Raises:
        ValueError: no drag moved the tool.
    """
    sent, moved = log["sent"], np.array(log["moved"])
    drawn = dict(map(tuple, log["drawn"]))
    rows = []
    for k, (pointer, message) in enumerate(sent):
        until = sent[k + 1][1] if k + 1 < len(sent) else np.inf
        came = moved[(moved >= message) & (moved < until)]
        if len(came) and came[0] in drawn:
            rows.append((message - pointer, came[0] - message, drawn[came[0]] - pointer))
    if not rows:
        raise ValueError("no drag moved the tool: the mouse missed the gizmo's arrow")
    return np.array(rows)


def show(result: dict[str, Any], console: Any) -> None:
    """Print the result."""
    console.print(f"[bold]{result['what']}[/]: {result['triangles']:,} triangles")
    for name in (
        "input to message [ms]",
        "message to moved tool [ms]",
        "input to moved tool [ms]",
        "input to picture [ms]",
    ):
        median, p90 = result[name]
        console.print(f"  {name:28} median {median:6.1f}   p90 {p90:6.1f}")
    console.print(
        f"  of {result['drags']} drag events; {result['updates/s']:.1f} updates/s, "
        f"{result['pictures/s']:.1f} pictures/s"
    )
    window = result["window"]
    across, down = window["canvas"]
    smoothed = "smoothed" if window["smoothed"] else "not smoothed"
    console.print(
        f"  window {window['width']} × {window['height']} at {window['ratio']:g}; the scene's "
        f"{window['css'][0]} × {window['css'][1]} drawn\n"
        f"  with {across} × {down} pixels, edges {smoothed}, by\n  {window['renderer']}"
    )
    for name in ("loop while dragging", "loop on autopilot"):
        row = result[name]
        console.print(
            f"  {name}: {row['rate [Hz]']:.1f} Hz, {100 * row['punctual']:.2f} % on time, "
            f"p99 late {row['late [us]']['p99']:.0f} µs"
        )


def _arrow(page: Any, box: dict[str, float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Position of the gizmo's x arrow in the window, and one move along it, (2,) each [px]."""
    from app.view.drawing.proxy import GIZMO_SIZE

    (client,) = page.server.get_clients().values()
    camera = client.camera
    wxyz, origin = page.gizmo_pose
    R_camera, R_gizmo = _matrix(camera.wxyz), _matrix(wxyz)
    focal = 0.5 * box["height"] / np.tan(0.5 * camera.fov)

    def on_screen(p: NDArray[np.float64]) -> NDArray[np.float64]:
        right, down, forward = R_camera.T @ (p - camera.position)
        centre = np.array([box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]])
        return np.asarray(centre + focal * np.array([right, down]) / forward)

    depth = float(np.linalg.norm(origin - camera.position))
    head = on_screen(origin + SHAFT * GIZMO_SIZE * depth / focal * R_gizmo[:, 0])
    along = head - on_screen(origin)
    return head, MOVE * along / np.linalg.norm(along)


def _matrix(wxyz: NDArray[np.float64]) -> NDArray[np.float64]:
    import pinocchio as pin

    w, x, y, z = wxyz
    return np.asarray(pin.Quaternion(w, x, y, z).matrix())


def _serve_requests(browser: Any, url: str) -> None:
    tab = browser.new_page(viewport=WINDOW, device_scale_factor=RATIO)
    tab.add_init_script(_HOOK)
    tab.goto(url)
    tab.wait_for_selector("canvas", timeout=60_000)
    tab.get_by_text("Ready: drag the tool").wait_for(timeout=60_000)
    answer(ready=True)
    for line in sys.stdin:
        order = json.loads(line)
        if order["do"] == "box":
            answer(**tab.locator("canvas").first.bounding_box())
        elif order["do"] == "picture":
            answer(**tab.evaluate(_PICTURE))
        elif order["do"] == "drag":
            _drag(tab, np.array(order["at"]), np.array(order["by"]), order["count"])
            answer()
        else:
            answer(**tab.evaluate("window.vf"))


def _drag(tab: Any, at: NDArray[np.float64], by: NDArray[np.float64], count: int) -> None:
    """Press at (2,), move by (2,) and back, `count` times in all, let go [px]."""
    tab.mouse.move(*at)
    tab.wait_for_timeout(1000)  # the page picks the object under the mouse once per frame
    tab.mouse.down()
    tab.wait_for_timeout(1000)
    for k in range(count):
        tab.mouse.move(*(at + (k % 2 == 0) * by))
        tab.wait_for_timeout(1000 * PAUSE)
    tab.mouse.up()


if __name__ == "__main__":
    sys.exit(browse(lambda browser: _serve_requests(browser, sys.argv[1])))

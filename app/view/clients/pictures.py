"""Screenshots: a client's view as PNG or animated GIF, the scene as one HTML file."""

from __future__ import annotations

import io
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray
from PIL import Image

from app.files import harmless
from app.view.context import PageContext

SIZE = (720, 1280)  # height and width of pictures [px]
FRAMES, INTERVAL = 20, 0.2  # of an image sequence; time between two frames [s]
TIMEOUT = 20.0  # for a browser's picture [s]

Job = Callable[[viser.ClientHandle], None]


class Pictures:
    """The buttons, added to the current container."""

    def __init__(
        self,
        context: PageContext,
        bind: Callable[[Any, Job], None],
        progress: Callable[[str], None],
    ) -> None:
        """Add the buttons.

        Args:
            bind: sets a button's job, which may block.
            progress: shows the progress of a long job.
        """
        self._context, self._progress = context, progress
        gui = context.server.gui
        picture_ = gui.add_button(
            "Screenshot", hint="Your view, without the panels.", icon=viser.Icon.CAMERA
        )
        sequence = gui.add_button(
            "Image sequence",
            hint=f"{FRAMES} pictures in {FRAMES * INTERVAL:g} s as one animated GIF.",
            icon=viser.Icon.MOVIE,
        )
        page = gui.add_button(
            "Scene as HTML", hint="One file that shows the scene in any browser, offline."
        )
        bind(picture_, self._screenshot)
        bind(sequence, self._images)
        bind(page, self._scene_page)

    def _screenshot(self, client: viser.ClientHandle) -> None:
        client.send_file_download(
            f"{self._name()}.png", png(picture(client)), save_immediately=True
        )

    def _images(self, client: viser.ClientHandle) -> None:
        self._progress(f"Taking {FRAMES} pictures …")
        taken = []
        due = time.monotonic()
        for _ in range(FRAMES):
            taken.append(picture(client))
            due = max(due + INTERVAL, time.monotonic())
            time.sleep(max(due - time.monotonic(), 0.0))
        client.send_file_download(f"{self._name()}.gif", gif(taken), save_immediately=True)

    def _scene_page(self, client: viser.ClientHandle) -> None:
        # The serializer also records removals, so it writes its file before the labels are removed.
        with self._context.labels.in_scene():
            content = self._context.server.get_scene_serializer().as_html().encode()
        client.send_file_download(f"{self._name()}.html", content, save_immediately=True)

    def _name(self) -> str:
        mesh = self._context.source.shown.scene.mesh_name
        return harmless(f"vf-sandbox_{mesh}_{time.strftime('%H-%M-%S')}", "vf-sandbox")


def picture(client: viser.ClientHandle) -> NDArray[np.uint8]:
    """A client's view of the scene (h, w, 3), no larger than its window.

    Raises:
        TimeoutError: the browser sent none; a hidden tab does not render.
    """
    camera = client.camera
    height, width = (
        min(SIZE[0], int(camera.image_height) or SIZE[0]),
        min(SIZE[1], int(camera.image_width) or SIZE[1]),
    )
    image = client.get_render(height, width, transport_format="jpeg", timeout=TIMEOUT)
    return np.ascontiguousarray(image[..., :3])


def png(image: NDArray[np.uint8]) -> bytes:
    """An image (h, w, 3) as a PNG file."""
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, "PNG")
    return stream.getvalue()


def gif(images: list[NDArray[np.uint8]]) -> bytes:
    """Images (h, w, 3) as a looping animated GIF."""
    first, *rest = (Image.fromarray(image).convert("RGB") for image in images)
    stream = io.BytesIO()
    first.save(
        stream, "GIF", save_all=True, append_images=rest, duration=round(1e3 * INTERVAL), loop=0
    )
    return stream.getvalue()

"""The heat map of margins on the page: drawn with its legend, switched off as a layer."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from app.session import Session
from app.settings import Options, Registration
from app.view import Page, camera
from tests.support.watching import Visitor, wait_until

pytestmark = pytest.mark.slow

FIDUCIALS = ((0.03, 0.05, 0.02), (-0.03, 0.05, 0.02), (0.03, -0.05, 0.03), (-0.03, -0.05, 0.03))


@pytest.fixture(scope="module")
def session(chromium: str) -> Iterator[Session]:
    own = Registration(FIDUCIALS, 0.5e-3)
    with Session(Options(mesh="skull-coarse", rate=500.0, registration=own)) as session:
        yield session


@pytest.fixture(scope="module")
def visitor(page: Page, open_tab: Callable[[Page], Visitor]) -> Visitor:
    return open_tab(page)


def bluish(picture: np.ndarray) -> float:
    """Share of pixels (h, w, 3) that are bluer than they are red, as no bone is."""
    red, blue = picture[..., 0].astype(int), picture[..., 2].astype(int)
    return float((blue > red + 25).mean())


def test_the_skull_has_the_colours_of_its_margins_until_the_layer_is_off(
    visitor: Visitor, session: Session, page: Page
) -> None:
    camera.move(visitor.client, camera.anatomy_view(session.scene))
    (low, high) = session.scene.added_range[0]
    legend = visitor.tab.locator(".vf-heat")
    legend.wait_for()
    assert f"{1e3 * low:.2f} – {1e3 * high:.2f}" in legend.inner_text()
    wait_until(lambda: bluish(visitor.picture("margins")) > 0.05, "the heat map to be drawn")
    visitor.tab.get_by_text("Layers", exact=True).click()
    visitor.tab.get_by_label("Margins", exact=True).click()
    wait_until(lambda: page._anatomy.margins is None, "the layer to be off")
    wait_until(lambda: bluish(visitor.picture("margins-off")) < 0.03, "bone to be bone")
    wait_until(lambda: legend.count() == 0, "the legend to go")
    visitor.tab.get_by_label("Margins", exact=True).click()
    wait_until(lambda: bluish(visitor.picture("margins")) > 0.05, "the heat map to be back")
    assert visitor.complaints == []

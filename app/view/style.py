"""Style sheet of the page: what viser's own layout leaves to be wished for; light and dark."""

from __future__ import annotations

import viser

from app.view import palette

# What our own HTML is coloured by, on light and on dark panels.
_COLOURS = """
:root { --vf-ink: #222; --vf-soft: #505050; --vf-faint: #6b6b6b; --vf-plate: #f3f3f3; }
[data-mantine-color-scheme="dark"] {
  --vf-ink: #e8e8e8; --vf-soft: #c0c0c0; --vf-faint: #a0a0a0; --vf-plate: #383838; }
"""

# The scene has black lines and a black shaft for everybody, so behind it is no night on anybody's
# page. And words in the palette's dark colours are lightened on dark panels.
_DARK = "".join(
    f'[data-mantine-color-scheme="dark"] {what} }}\n'
    for what in (
        "canvas[data-engine] { background: #8b939c;",
        f'div[style*="color:{palette.css(palette.BLACK)}"] {{ color: #e8e8e8 !important;',
        f'div[style*="color:{palette.css(palette.BLUE)}"] {{ color: #62b5ec !important;',
        f'div[style*="color:{palette.css(palette.GREY)}"] {{ color: #b0b0b0 !important;',
    )
)

# Below 36em viser shows all panels in one sheet at the bottom that hides more than half of the
# scene, is narrower than the screen and cannot be told otherwise by the server. Its parts have no
# names of their own, so the sheet is found by how viser styles it; if that ever changes the page
# still works, only less well on a phone.
_PHONE = """
@media (max-width: 36em) {
  [style*="max-height: 60%"][style*="position: fixed"] {
    width: 100% !important; max-height: 42% !important; }
  [style*="max-height: 60%"][style*="position: fixed"] [style*="width: 20em"] {
    width: 100% !important; }
  .vf-title { display: none; }
  .vf-sentence { height: 2.7em !important; }
}
"""

# Six tabs are to fit beside each other.
_TABS = """
[data-dock-tab] { padding: 0 .38em !important; font-size: 11px; letter-spacing: -.3px; }
"""

# Five plots are to fit under each other.
_PLOTS = """
.uplot-container .u-title { font-size: 11px; line-height: 15px; font-weight: 600; }
.uplot-container { margin: 0 .75em 3px !important; }
.uplot .u-legend { margin: 0 !important; text-align: center; }
.uplot .u-legend .u-marker { border-radius: 2px; }

"""

_HELP = """
.vf-help { font-size: 13.5px; line-height: 1.45; margin: 0; padding: 0 0 0 1.3em; }
.vf-help li { margin-bottom: 5px; }
.vf-help kbd { font: inherit; font-size: 12px; padding: 0 4px; border: 1px solid #999;
  border-radius: 3px; background: var(--vf-plate); white-space: nowrap; }
"""


def sheet() -> str:
    """The style sheet as an HTML element."""
    return f"<style>{_COLOURS}{_DARK}{_PHONE}{_TABS}{_PLOTS}{_HELP}</style>"


def colour(gui: viser.GuiApi, dark: bool) -> None:
    """Panels in light or dark colours: on every page, or on one if `gui` is a client's own."""
    gui.configure_theme(
        control_width="medium",
        dark_mode=dark,
        show_logo=False,
        show_share_button=False,
        brand_color=palette.SKY if dark else palette.BLUE,
    )

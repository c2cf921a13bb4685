"""Style sheet and theme of the page; light and dark."""

from __future__ import annotations

import viser

from app.view import palette

# Colours of our own HTML on light and on dark panels.
_COLOURS = """
:root { --vf-ink: #222; --vf-soft: #505050; --vf-faint: #6b6b6b; --vf-plate: #f3f3f3; }
[data-mantine-color-scheme="dark"] {
  --vf-ink: #e8e8e8; --vf-soft: #c0c0c0; --vf-faint: #a0a0a0; --vf-plate: #383838; }
"""

# Dark theme: a grey scene background, as the scene has black lines and a black shaft; and lighter
# shades of the palette's dark text colours.
_DARK = "".join(
    f'[data-mantine-color-scheme="dark"] {what} }}\n'
    for what in (
        "canvas[data-engine] { background: #8b939c;",
        f'div[style*="color:{palette.css(palette.BLACK)}"] {{ color: #e8e8e8 !important;',
        f'div[style*="color:{palette.css(palette.BLUE)}"] {{ color: #62b5ec !important;',
        f'div[style*="color:{palette.css(palette.GREY)}"] {{ color: #b0b0b0 !important;',
    )
)

# Below 36em viser shows all panels in one sheet at the bottom, which hides more than half of the
# scene and is narrower than the screen. The server cannot configure it; it has no class or id, so
# it is selected by its inline style.
_PHONE = """
@media (max-width: 36em) {
  [style*="max-height: 60%"][style*="position: fixed"] {
    width: 100% !important; max-height: 42% !important; }
  [style*="max-height: 60%"][style*="position: fixed"] [style*="width: 20em"] {
    width: 100% !important; }
  .vf-title { display: none; }
  .vf-banner { min-height: calc(2.7em + 6px) !important; }
  .vf-sentence { height: 2.7em !important; }
}
"""

# So that six tabs fit side by side.
_TABS = """
[data-dock-tab] { padding: 0 .38em !important; font-size: 11px; letter-spacing: -.3px; }
"""

# So that five plots fit below each other.
_PLOTS = """
.uplot-container .u-title { font-size: 11px; line-height: 15px; font-weight: 600; }
.uplot-container { margin: 0 .75em 3px !important; }
.uplot .u-legend { margin: 0 !important; text-align: center; }
.uplot .u-legend .u-marker { border-radius: 2px; }

"""

# The list of structures, and the hidden text field behind it that takes its orders.
_STRUCTURES = """
div:has(> .vf-orders) + * { display: none !important; }
.vf-structures { width: calc(100% - 1.5em); margin: 0 .75em .4em; border-collapse: collapse;
  table-layout: fixed; font-size: 12px; line-height: 19px; color: var(--vf-ink);
  font-variant-numeric: tabular-nums; }
.vf-structures td, .vf-structures th { padding: 0 2px; white-space: nowrap; overflow: hidden;
  text-overflow: ellipsis; text-align: right; font-weight: normal; }
.vf-structures th { color: var(--vf-faint); font-size: 11px; }
.vf-structures .vf-name { text-align: left; }
.vf-structures button { all: unset; cursor: pointer; width: 100%; overflow: hidden;
  text-overflow: ellipsis; display: block; }
.vf-structures button:focus-visible { outline: 2px solid var(--vf-soft); outline-offset: -2px; }
.vf-structures .vf-off { color: var(--vf-faint); }
.vf-structures .vf-chosen td { background: var(--vf-plate); }
.vf-structures .vf-chosen .vf-name { font-weight: 600; }
.vf-swatch { display: inline-block; width: 10px; height: 10px; margin-right: 4px;
  border-radius: 2px; border: 1px solid var(--vf-faint); vertical-align: -1px; }
@media (pointer: coarse) { .vf-structures { line-height: 30px; } }
"""

_HELP = """
.vf-help { font-size: 13.5px; line-height: 1.45; margin: 0; padding: 0 0 0 1.3em; }
.vf-help li { margin-bottom: 5px; }
.vf-help kbd { font: inherit; font-size: 12px; padding: 0 4px; border: 1px solid #999;
  border-radius: 3px; background: var(--vf-plate); white-space: nowrap; }
"""


def sheet() -> str:
    """The style sheet as an HTML element."""
    return f"<style>{_COLOURS}{_DARK}{_PHONE}{_TABS}{_PLOTS}{_STRUCTURES}{_HELP}</style>"


def set_theme(gui: viser.GuiApi, dark: bool) -> None:
    """Light or dark panels; on one page only if `gui` is a client's own."""
    gui.configure_theme(
        control_width="medium",
        dark_mode=dark,
        show_logo=False,
        show_share_button=False,
        brand_color=palette.SKY if dark else palette.BLUE,
    )

"""Style sheet of the page: what viser's own layout leaves to be wished for."""

from __future__ import annotations

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
"""

_HELP = """
.vf-help { font-size: 13.5px; line-height: 1.45; margin: 0; padding: 0 0 0 1.3em; }
.vf-help li { margin-bottom: 5px; }
.vf-help kbd { font: inherit; font-size: 12px; padding: 0 4px; border: 1px solid #bbb;
  border-radius: 3px; background: #f6f6f6; white-space: nowrap; }
"""


def sheet() -> str:
    """The style sheet as an HTML element."""
    return f"<style>{_PHONE}{_TABS}{_PLOTS}{_HELP}</style>"

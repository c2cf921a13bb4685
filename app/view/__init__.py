"""The page: shows a session in browsers, and passes their input on to it.

`Page` reads `Session.latest()` and `Session.scene`, writes viser nodes, and calls the session's
methods; it decides nothing about motion.
"""

from app.view.page import Page

__all__ = ["Page"]

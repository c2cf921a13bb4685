"""The page: what a browser shows of a session, and what the operator's hand sends to it.

`Page` is the door. It reads `Session.latest()` and `Session.scene`, writes viser nodes, and hands
input over to the session's methods; it decides nothing about motion.
"""

from app.view.page import Page

__all__ = ["Page"]

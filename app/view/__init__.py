"""The page: shows a session in browsers, and passes their input on to it.

`Page` reads `Session.latest()` and `Session.scene`, writes viser nodes, and calls the session's
methods; it decides nothing about motion. `page` lists the parts. What is drawn in the scene is in
`drawing`, the panel on the right in `controls`, that on the left in `tabs` and `inspector`, what
each browser has of its own in `clients`, and what checks the messages of browsers in `guard`.
"""

from app.view.page import Page

__all__ = ["Page"]

"""Protection of the page's server: who may connect, and what clients may send.

viser has no authentication, checks no Origin, validates no message and opens a public tunnel when a
client asks for one. `serve` builds a viser server with these checks: `Access` decides about every
HTTP request, `Connection` limits what a WebSocket sends and receives, `problem_with` validates its
messages. All use of viser's and websockets' internals is in this package; `patches.check_internals`
fails at the start when they have changed.
"""

from app.view.guard.access import token_for
from app.view.guard.logs import quiet_console
from app.view.guard.patches import GuardError
from app.view.guard.server import resource_counts, serve

__all__ = ["GuardError", "quiet_console", "resource_counts", "serve", "token_for"]

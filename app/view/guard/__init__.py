"""What stands between the page and the network: who may connect, and what they may send.

viser asks nobody for a name, checks no Origin, believes what clients say and opens a tunnel to the
public when one asks for it. Now and then it also stops sending for good. All that is put right
here, and everything of viser's and websockets' insides that it takes; `repairs.check` says so at
the start should one of them have changed.

`serve` is where it comes together: a request must pass the `Door`, a WebSocket is a `Connection`
from then on, and a connection hands on no message that `problem_with` finds fault with.
"""

from app.view.guard.complaints import quiet_console
from app.view.guard.door import token_for
from app.view.guard.repairs import Unguarded
from app.view.guard.server import census, serve

__all__ = ["Unguarded", "census", "quiet_console", "serve", "token_for"]

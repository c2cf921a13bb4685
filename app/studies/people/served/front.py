"""The front page of a study: participants enter by their code and fill in forms.

Forms are answered here, trials are done in a process of the participant's own (`room`); both keep
what was done in the study's folder and nowhere else.
"""

from __future__ import annotations

import logging
import threading
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from websockets.datastructures import Headers
from websockets.http11 import Request

from app.studies.people.folder import Study, checked_code
from app.studies.people.served import html
from app.studies.people.served.places import Places, cores
from app.studies.people.sitting import OVER, SCALES, Sitting
from app.view import guard
from app.view.guard.access import COOKIE, Access
from app.words import OptionError, Refused

log = logging.getLogger(__name__)

CODE = "vf-study-code-"  # name of the cookie, followed by the port
LARGEST = 100_000  # of a form [byte]
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; "
    "frame-ancestors 'none'; base-uri 'none'",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",  # with no-referrer browsers send no Origin with a form
    "Cache-Control": "no-store",
}


class Front:
    """Serves a study. Close it to end the participants' processes; what they did is kept.

    Attributes:
        study: the study.
        places: who is there.
        port: in use.
    """

    def __init__(
        self, folder: Path, protocol: str, host: str, port: int, most: int | None = None
    ) -> None:
        """Start serving.

        Args:
            protocol: built-in name, or path of a file.
            port: 0: any free one.
            most: participants at once; None: one per core.

        Raises:
            OptionError: an invalid protocol, or a folder of another study.
            OSError: the folder cannot be made, or the port is taken.
        """
        self.study = Study.make(folder, protocol)
        self.host = host
        self.token = guard.token_for(host)
        self.access = Access(host, self.token)
        self.places = Places(folder, host, cores() if most is None else most)
        handler = type("Handler", (_Handler,), {"front": self})
        self._server = ThreadingHTTPServer((host, port), handler)
        self.port = int(self._server.server_address[1])
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.1,), name="front", daemon=True
        )
        self._thread.start()

    @property
    def url(self) -> str:
        """The address for participants, with the token."""
        host = "127.0.0.1" if self.host in ("0.0.0.0", "::", "") else self.host
        name = f"[{host}]" if ":" in host else host
        return f"http://{name}:{self.port}/" + (f"?token={self.token}" if self.token else "")

    def close(self) -> None:
        """Stop serving, and end all processes."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
        self.places.close()


class _Handler(BaseHTTPRequestHandler):
    """One request."""

    front: Front
    _cookies: list[str]  # to be set by the answer
    protocol_version = "HTTP/1.1"
    timeout = 20.0
    server_version, sys_version = "vf-sandbox", ""

    def do_GET(self) -> None:
        if not self._allowed():
            return
        path = urlsplit(self.path).path
        if path == "/":
            self._page(html.enter(self.front.study.protocol))
        elif path == "/go":
            self._go()
        elif path == "/stop":
            self._page(html.stop())
        else:
            self._page(html.page("There is no such page", '<p><a href="/">Begin</a></p>'), 404)

    def do_POST(self) -> None:
        form = self._form()
        if form is None or not self._allowed():
            return
        path = urlsplit(self.path).path
        if path == "/enter":
            self._enter(form.get("code", ""))
            return
        sitting = self._sitting()
        if sitting is None:
            self._to("/")
            return
        steps = {
            "/consent": self._consent, "/answers": self._answers, "/tlx": self._rate,
            "/rested": self._rested, "/withdraw": self._withdraw,
        }  # fmt: skip
        step = steps.get(path)
        if step is None:
            self._to("/go")
            return
        step(sitting, form)

    # Steps

    def _enter(self, text: str) -> None:
        front = self.front
        try:
            code = checked_code(text, front.study.protocol)
            if not front.places.take(code):
                self._page(html.full(front.places.most), HTTPStatus.SERVICE_UNAVAILABLE)
                return
            sitting = Sitting.enter(front.study, code)
        except Refused as reason:
            self._page(html.enter(front.study.protocol, f"{reason}.", text[:24]), 400)
            return
        self._cookies = [f"{CODE}{front.port}={sitting.code}; Path=/; HttpOnly; SameSite=Strict"]
        self._to("/go")

    def _go(self) -> None:
        """The page of the stage the participant is at."""
        sitting = self._sitting()
        if sitting is None:
            self._to("/")
            return
        front = self.front
        if sitting.stage in OVER:
            front.places.leave(sitting.code)
            self._page(html.over(sitting))
            return
        if not front.places.take(sitting.code):
            self._page(html.full(front.places.most), HTTPStatus.SERVICE_UNAVAILABLE)
            return
        if sitting.stage == "consent":
            self._page(html.consent(sitting))
            return
        # Started early, so that it is ready when the forms are filled in.
        room = front.places.room(sitting.code, f"http://{self.headers['Host']}")
        if sitting.stage in ("training", "trial"):
            if room.port is None:
                self._page(html.wait())
                return
            host = urlsplit(f"//{self.headers['Host']}").hostname or "127.0.0.1"
            name = f"[{host}]" if ":" in host else host
            token = "" if room.token is None else f"?token={room.token}"
            self._to(f"http://{name}:{room.port}/{token}")
            return
        shown = {"questions": html.questions, "tlx": html.workload, "rest": html.rest}
        self._page(shown[sitting.stage](sitting))

    def _consent(self, sitting: Sitting, form: dict[str, str]) -> None:
        agreed = form.get("agree")
        if agreed == "no":
            self._try(lambda: sitting.consent(False))
            if sitting.stage == "withdrawn":
                self.front.places.leave(sitting.code)
                self._page(html.over(None))
                return
        elif agreed == "yes":
            self._try(lambda: sitting.consent(True))
        self._to("/go")

    def _answers(self, sitting: Sitting, form: dict[str, str]) -> None:
        given = {key[2:]: value for key, value in form.items() if key.startswith("q-")}
        wrong = self._try(lambda: sitting.answer(given))
        if wrong and sitting.stage == "questions":
            self._page(html.questions(sitting, wrong, given), 400)
            return
        self._to("/go")

    def _rate(self, sitting: Sitting, form: dict[str, str]) -> None:
        wrong = self._try(lambda: sitting.rate({k: form[k] for k in SCALES if k in form}))
        if wrong and sitting.stage == "tlx":
            self._page(html.workload(sitting, wrong), 400)
            return
        self._to("/go")

    def _rested(self, sitting: Sitting, _form: dict[str, str]) -> None:
        self._try(sitting.rested)
        self._to("/go")

    def _withdraw(self, sitting: Sitting, _form: dict[str, str]) -> None:
        self._try(sitting.withdraw)
        self._to("/go")

    @staticmethod
    def _try(step: Any) -> str:
        """Take a step; why it was refused, or empty. Twice the same is refused too."""
        try:
            step()
        except Refused as reason:
            return str(reason)
        return ""

    # HTTP

    def _allowed(self) -> bool:
        """Whether host, origin, token and rate are as the page's guard wants them."""
        self._cookies = []
        request = Request(self.path, Headers(self.headers.items()))
        refusal = self.front.access.refusal(request)
        if refusal is not None:
            self._page(html.page("Refused", f"<p>{html.escape(refusal[1])}</p>"), refusal[0])
            return False
        token = self.front.token
        if token is not None and f"token={token}" in urlsplit(self.path).query:
            self._cookies.append(
                f"{COOKIE}{self.front.port}={token}; Path=/; HttpOnly; SameSite=Strict"
            )
        return True

    def _form(self) -> dict[str, str] | None:
        """The fields of the form that was sent; None: it was refused."""
        self._cookies = []
        try:
            length = int(self.headers.get("Content-Length", "0"))
        except ValueError:
            length = -1
        if not 0 <= length <= LARGEST:
            self.close_connection = True
            self._page(html.page("Refused", "<p>This is too long.</p>"), 413)
            return None
        text = self.rfile.read(length).decode("utf-8", "replace")
        try:
            fields = parse_qs(text, keep_blank_values=True, max_num_fields=200)
        except ValueError:
            fields = {}
        return {key: values[0] for key, values in fields.items()}

    def _sitting(self) -> Sitting | None:
        """The participant of the cookie; None: there is none, or it is none."""
        try:
            cookie = SimpleCookie(self.headers.get("Cookie", "")).get(f"{CODE}{self.front.port}")
            return None if cookie is None else Sitting(self.front.study, cookie.value)
        except (CookieError, Refused, OptionError):
            return None

    def _to(self, where: str) -> None:
        self._answer(HTTPStatus.SEE_OTHER, b"", {"Location": where})

    def _page(self, text: str, status: int = HTTPStatus.OK) -> None:
        self._answer(status, text.encode("utf-8"), {"Content-Type": "text/html; charset=utf-8"})

    def _answer(self, status: int, body: bytes, more: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in (HEADERS | more | {"Content-Length": str(len(body))}).items():
            self.send_header(name, value)
        for cookie in self._cookies:
            self.send_header("Set-Cookie", cookie)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *arguments: Any) -> None:
        log.debug(*arguments)

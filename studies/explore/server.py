"""The page's server on 127.0.0.1. It refuses addresses without the token, and requests of other hosts and origins."""

import json
import secrets
import sys
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources

from linkplan.models.errors import LinkplanError, one_line
from linkplan.studies.explore.session import Save, Session
from linkplan.studies.output.report_file import document_json, report_html

# Largest body of a request [bytes]: enough for about a hundred sliders.
_MAX_BODY_BYTES = 100_000


class Server(ThreadingHTTPServer):
    """The server of a session. `address` is what the browser opens."""

    daemon_threads = True
    allow_reuse_address = False

    def __init__(
        self, session: Session, save: Save, port: int = 0, tell: Callable[[BaseException], None] = lambda _: None
    ) -> None:
        """Make the server; `tell` is called with unexpected errors."""
        self.session, self.save, self.tell, self.token = session, save, tell, secrets.token_urlsafe(16)
        ThreadingHTTPServer.__init__(self, ("127.0.0.1", port), _Handler)

    @property
    def hosts(self) -> tuple[str, str]:
        """The values of the Host header that a browser on this machine sends."""
        return f"127.0.0.1:{self.server_port}", f"localhost:{self.server_port}"

    @property
    def address(self) -> str:
        """The page's address, with the token."""
        return f"http://{self.hosts[0]}/{self.token}/"

    def handle_error(self, request: object, client_address: object) -> None:  # noqa: ARG002
        """Ignore a closed connection; report any other error."""
        error = sys.exception()
        if error is not None and not isinstance(error, ConnectionError | TimeoutError):
            self.tell(error)

    def answer(self, path: str, asked: Mapping) -> tuple[str, bytes]:
        """Return the status, the type and the content of a path below the token."""
        session = self.session
        if path == "plan":
            document, said = session.report(asked.get("values", {}), asked.get("objective"), asked.get("tracker"))
            return "application/json", b'{"said": %b, "document": %b}' % (_json(said), document_json(document))
        if path == "save":
            return "application/json", _json({"saved": f"{self.save(session.described())}: {session.changes()}"})
        if path == "controls":
            return "application/json", _json(session.controls())
        document, _ = session.report({}, None)
        folder = resources.files("linkplan.studies.explore").joinpath("page")
        program = folder.joinpath("explore.js").read_text(encoding="utf-8")
        return "text/html; charset=utf-8", report_html(document, served=program).encode("utf-8", "replace")


class _Handler(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        """Answer with the page or its sliders."""
        self._respond(("", "controls"), {})

    def do_POST(self) -> None:
        """Answer with a plan, or save the problem."""
        try:
            length = int(self.headers.get("Content-Length", ""))
            asked = json.loads(self.rfile.read(length)) if 0 <= length <= _MAX_BODY_BYTES else None
        except (ValueError, RecursionError):
            asked = None
        self._respond(("plan", "save"), asked)

    def _respond(self, paths: tuple[str, ...], asked: object) -> None:
        token, _, path = self.path.removeprefix("/").partition("/")
        origin = self.headers.get("Origin")
        ours = self.headers.get("Host") in self.server.hosts
        same = origin is None or origin.removeprefix("http://") in self.server.hosts
        if not (ours and same and secrets.compare_digest(token.encode(), self.server.token.encode())):
            self._send(403, "text/plain", b"refused: another host, or not the address that was printed\n")
        elif path not in paths:
            self._send(404, "text/plain", b"there is nothing here\n")
        elif not isinstance(asked, dict):
            self._send(400, "text/plain", b"a JSON object is needed\n")
        elif not isinstance(asked.get("values", {}), dict) or not all(
            isinstance(asked.get(name), str | None) for name in ("objective", "tracker")
        ):
            self._send(400, "text/plain", b"values are a JSON object, objective and tracker are texts\n")
        else:
            self._send(*self._answer(path, asked))

    def _answer(self, path: str, asked: dict) -> tuple[int, str, bytes]:
        try:
            return (200, *self.server.answer(path, asked))
        except LinkplanError as error:
            return 200, "application/json", _json({"refused": one_line(error)})
        except Exception as error:
            self.server.tell(error)
            return 500, "text/plain", b"an internal error of linkplan; see its terminal\n"

    def _send(self, code: int, kind: str, content: bytes) -> None:
        self.send_response(code)
        for name, value in (("Content-Type", kind), ("Content-Length", str(len(content))), ("Cache-Control", "no-store")):
            self.send_header(name, value)
        self.send_header("Referrer-Policy", "no-referrer")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Write nothing, because stderr is for the command's own lines."""


def _json(value: object) -> bytes:
    return json.dumps(value).encode()

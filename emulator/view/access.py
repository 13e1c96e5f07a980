"""Who may come in: rules over one request, without a server.

Belongs here: which token, host and origin open the page, and with which words and headers it is answered. Not: sockets
and viser (door).

The token is the first part of the path. A browser sends a path to nobody but the server it was typed for, while it
sends a cookie to every port of the host. `Host` has to be what was opened, so that a name that an attacker lets point
here (DNS rebinding) is none; `Origin`, which a browser adds by itself wherever a page asks for something, has to be the
page's own. Programs that are no browsers send no `Origin` and need the token alone.
"""

from __future__ import annotations

import hmac
import re
import secrets
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from http import HTTPStatus
from urllib.parse import SplitResult, parse_qs, urlsplit

from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from emulator.errors import EmulatorError

LOCAL = ("127.0.0.1", "localhost", "::1")
EVERY = ("0.0.0.0", "::", "")
"Addresses that stand for all of this machine."
HOST = re.compile(r"(\w+://)?[][\w.:-]+", re.ASCII)
DEFAULT_PORTS = {"http": 80, "https": 443}
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' blob:; script-src-attr 'none';"
    " style-src 'unsafe-inline'; img-src data: blob:; font-src data:; worker-src blob: data:;"
    " connect-src {socket} data: blob:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
"The browser fetches nothing from elsewhere, and text of the page that became an element could not act."
HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}


@dataclass(frozen=True)
class Place:
    """An address that browsers may have opened."""

    scheme: str
    host: str
    "Small letters; IPv6 in brackets."
    port: int

    @property
    def hosts(self) -> tuple[str, ...]:
        """What `Host` may say; a scheme's own port is left out by browsers."""
        full = f"{self.host}:{self.port}"
        return (self.host, full) if DEFAULT_PORTS[self.scheme] == self.port else (full,)


def place_of(text: str) -> Callable[[int], Place]:
    """`NAME`, `NAME:PORT` or `https://NAME[:PORT]`, given the page's own port. Raises `EmulatorError`."""
    wanted = f"--allow-host: {text!r}; want NAME, NAME:PORT or https://NAME[:PORT]"
    try:
        found: SplitResult = urlsplit(text if "://" in text else f"http://{text}")
        name, port = found.hostname or "", found.port
    except ValueError:
        raise EmulatorError(wanted) from None
    if not name or not HOST.fullmatch(text) or found.scheme not in DEFAULT_PORTS:
        raise EmulatorError(wanted)
    if port is None and "://" in text:
        port = DEFAULT_PORTS[found.scheme]
    return lambda own: Place(found.scheme, bracketed(name), own if port is None else port)


def bracketed(name: str) -> str:
    """A host's name as it stands in an address."""
    return f"[{name}]" if ":" in name else name.lower()


class Lock:
    """Lets in who has the token and comes by an address that was opened."""

    def __init__(self, token: str, host: str = LOCAL[0], further: Iterable[str] = ()) -> None:
        """`host`: listened on; `further`: as given with `--allow-host`. Raises `EmulatorError`."""
        self._token = token
        self._host = host
        self._further = [place_of(text) for text in further]
        self._ticket = ""
        self.port = 0
        self.refused: Callable[[str], None] = lambda host: None
        "Given the host by which somebody came who has the token."

    def places(self, reached: str | None) -> Iterator[Place]:
        """Addresses that were opened; `reached`: that of this machine on which a connection came in."""
        names = set(LOCAL) if self._host in (*LOCAL, *EVERY) else {self._host}
        if reached is not None and self._host not in LOCAL:
            names.add(reached)
        for name in sorted(names):
            yield Place("http", bracketed(name), self.port)
        for further in self._further:
            yield further(self.port)

    def ticket(self) -> str:
        """A path that opens the page once: what starts a browser is seen by every user of this machine."""
        self._ticket = secrets.token_urlsafe(18)
        return f"/{self._ticket}"

    def ask(self, request: Request, inner: Callable[[Request], Response | None], reached: str | None = None) -> object:
        """The answer to a request, `inner`'s where the door opens; None: the handshake of a web socket goes on."""
        found = self._opens(request.path)
        if found is None:
            return answer(HTTPStatus.FORBIDDEN)
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        asked = hosts[0].lower() if len(hosts) == 1 else ""
        known = [place for place in self.places(reached) if asked in place.hosts]
        if not known:
            self.refused(hosts[0] if hosts else "")
            return answer(HTTPStatus.FORBIDDEN, self._reported(hosts))
        own = {f"{place.scheme}://{asked}" for place in known}
        if origins and (len(origins) > 1 or origins[0].lower() not in own):
            return answer(HTTPStatus.FORBIDDEN)
        if found == "moved":
            self._ticket = ""
            return answer(HTTPStatus.SEE_OTHER, location=f"/{self._token}/")
        if found != "/":
            return answer(HTTPStatus.NOT_FOUND)
        response = inner(Request("/", request.headers))
        if isinstance(response, Response):
            sockets = sorted(origin.replace("http", "ws", 1) for origin in own)
            _headed(response.headers, POLICY.format(socket=" ".join(sockets)))
        return response

    def _opens(self, path: str) -> str | None:
        """What is wanted behind the token; `moved` by another way than its path; None: stay outside."""
        if not path.startswith("/") or path.startswith("//"):
            return None
        try:
            split = urlsplit(path)
            asked = parse_qs(split.query, max_num_fields=16).get("token", [""])[0]
        except ValueError:
            return None
        given, slash, rest = split.path[1:].partition("/")
        if _same(given, self._token):
            return slash + rest or "/"
        if _same(asked, self._token) or (self._ticket and _same(given, self._ticket)):
            return "moved"
        return None

    def _reported(self, hosts: list[str]) -> str:
        """For who has the token: why there is nothing."""
        asked = " and ".join(host[:100] for host in hosts) or "no host"
        opened = ", ".join(dict.fromkeys(place.hosts[-1] for place in self.places(None)))
        return f"This page was opened for {opened}; the request is for {asked}. See lidaremu view --allow-host.\n"


def _same(given: str, wanted: str) -> bool:
    return hmac.compare_digest(given.encode(errors="surrogatepass"), wanted.encode())


def answer(status: HTTPStatus, text: str = "", location: str | None = None) -> Response:
    """A page of text, or none."""
    body = text.encode(errors="replace")
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    if location is not None:
        headers["Location"] = location
    _headed(headers, "default-src 'none'; frame-ancestors 'none'")
    return Response(status, status.phrase, headers, body)


def _headed(headers: Headers, policy: str) -> None:
    headers["Content-Security-Policy"] = policy
    for key, value in HEADERS.items():
        headers[key] = value

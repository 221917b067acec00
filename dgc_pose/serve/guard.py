"""Access control: only pages of this server, in a browser that was given the token.

It blocks three attacks. A site whose name resolves to 127.0.0.1 (DNS rebinding) sends its own name
as Host. A page of another origin sends its Origin, and cannot set the token's header without a CORS
permission, which the server never gives. A program of another user does not have the token.
"""

import secrets

from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

TOKEN_HEADER = "x-dgc-pose-token"
HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "cache-control": "no-store",
}


class Guard:
    """Answers 403 to requests that do not come from the server's page, before reading them."""

    def __init__(self, app: ASGIApp, *, token: str, hosts: frozenset[str]) -> None:
        """hosts: the accepted values of the header Host, such as 127.0.0.1:8000."""
        self._app = app
        self._token = token
        self._hosts = hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":  # the server's start; a web socket, which has no route
            return await self._app(scope, receive, send)

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        reason = self._refusal(Request(scope))
        app = self._app if reason is None else PlainTextResponse(reason, 403)
        await app(scope, receive, send_with_headers)

    def _refusal(self, request: Request) -> str | None:
        headers = request.headers
        path = request.scope["path"]
        if headers.get("host", "").lower() not in self._hosts:
            return "this server answers to its own name only"
        foreign = headers.get("sec-fetch-site", "none") not in ("none", "same-origin")
        origin = headers.get("origin")
        if foreign or (origin is not None and origin.removeprefix("http://") not in self._hosts):
            return "this server answers to its own pages only"
        if path.startswith("/static/"):
            return None  # public
        tokens = request.query_params if path == "/" else headers
        token = tokens.get("token" if path == "/" else TOKEN_HEADER, "")
        if not secrets.compare_digest(token.encode(), self._token.encode()):
            return "open the address that `dgc-pose serve` printed: it holds a token"
        return None


def local_hosts(port: int) -> frozenset[str]:
    """The values of the header Host of a server on this port of this machine."""
    ending = "" if port == 80 else f":{port}"
    return frozenset(f"{name}{ending}" for name in ("127.0.0.1", "localhost", "[::1]"))

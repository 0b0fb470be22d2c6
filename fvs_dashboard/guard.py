"""Access check of the page's websocket: only the page itself may open it, no other web site.

A browser lets any web site connect to this host, and a button is only a message. The page commands
an arm, so a request must come from this page (``Origin``), under a name of this host (``Host``; a
foreign name can be made to resolve to it). No other page may embed it in a frame, where a click on
that page could press a button of this one.
"""

from __future__ import annotations

import contextlib
import functools
import http.client
import inspect
import ipaddress
import socket
from collections.abc import Iterator, Mapping
from typing import Any
from urllib.parse import urlsplit

from websockets.asyncio import server

#: Addresses that only this host reaches, and its names for them.
LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})
#: Wildcards for every address of this host.
EVERYWHERE = frozenset({"0.0.0.0", "::", ""})
#: Headers that forbid other pages to embed this one, for present and old browsers.
_UNFRAMED = {"Content-Security-Policy": "frame-ancestors 'none'", "X-Frame-Options": "DENY"}


@functools.cache  # a look-up of the host's full name may take seconds
def own_names(host: str) -> frozenset[str]:
    """Names, besides addresses, that a request to a page served at a host may use.

    Other names are refused, because anyone can make their name resolve to this host.
    """
    if host not in EVERYWHERE:
        return LOOPBACK | {host.lower()}
    name = socket.gethostname().lower()
    return LOOPBACK | {name, f"{name}.local", socket.getfqdn().lower()}


def objection(headers: Mapping[str, str], served_at: str) -> str:
    """Why a request with these headers to a page served at a host is refused; empty if not."""
    host, origin = headers.get("Host", ""), headers.get("Origin")
    name, names = urlsplit(f"//{host}").hostname or "", own_names(served_at)
    # Served on all addresses, any address is valid: unlike a name it cannot be forged.
    if name not in names and not (served_at in EVERYWHERE and _is_address(name)):
        return f"the page is not served as {host}; it is as {' or '.join(sorted(names))}"
    if origin is not None and urlsplit(origin).netloc != host:
        return f"{origin} may not command this arm"
    return ""


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


@contextlib.contextmanager
def own_requests_only(host: str) -> Iterator[None]:
    """While active, servers started at a host refuse requests from other sites.

    viser has no setting for it, so this patches the function that starts its websocket server.
    """
    serve = server.serve

    def guarded(*args: Any, process_request: Any = None, **options: Any) -> Any:
        async def check(connection: Any, request: Any) -> Any:
            reason = objection(request.headers, host)
            if reason:
                answer = connection.respond(403, reason + "\n")
            else:
                answer = process_request(connection, request) if process_request else None
                answer = await answer if inspect.isawaitable(answer) else answer
            if answer is not None:  # not a websocket, which has no page
                answer.headers.update(_UNFRAMED)
            return answer

        return serve(*args, process_request=check, **options)

    server.serve = guarded  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]


def turns_others_away(host: str, port: int) -> bool:
    """Whether the server at a host and port refuses the websocket to a page of another site.

    It sends a real request, because a later viser may start its server without the check.
    """
    connection = http.client.HTTPConnection(host, port, timeout=10.0)
    headers = {
        "Origin": "http://not-this-page.invalid",
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
        "Sec-WebSocket-Version": "13",
    }
    with contextlib.closing(connection):
        try:
            connection.request("GET", "/", headers=headers)
            return connection.getresponse().status == http.client.FORBIDDEN
        except (OSError, http.client.HTTPException):
            return False

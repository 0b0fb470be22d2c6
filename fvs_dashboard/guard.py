"""Who may open the page's websocket: the page itself, not whatever else a browser has open.

A browser lets any web site connect to this host, and a press of a button is a message. The page
commands an arm, so that a request must come from the page it serves (``Origin``), and under a name
that is this host's (``Host``; another one's name may be made to point here). No other page may hold
it in a frame, where a click that is meant for that one would press a button of this one.
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

_CHECK_S = 10.0

#: Addresses that only this host reaches, and its names for them.
LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})
#: What stands for every address that this host has.
EVERYWHERE = frozenset({"0.0.0.0", "::", ""})
#: No other page may hold this one in a frame, in today's words and in those of old browsers.
_UNFRAMED = {"Content-Security-Policy": "frame-ancestors 'none'", "X-Frame-Options": "DENY"}


@functools.cache  # a look-up of the host's full name may take seconds
def own_names(host: str) -> frozenset[str]:
    """Names under which a page that is served at a host may be asked for, besides addresses.

    A name that is not this host's may have been made to point here by others.
    """
    if host not in EVERYWHERE:
        return LOOPBACK | {host.lower()}
    name = socket.gethostname().lower()
    return LOOPBACK | {name, f"{name}.local", socket.getfqdn().lower()}


def objection(headers: Mapping[str, str], served_at: str) -> str:
    """Why a request with these headers to a page that is served at a host is refused, or empty."""
    host, origin = headers.get("Host", ""), headers.get("Origin")
    name, names = urlsplit(f"//{host}").hostname or "", own_names(served_at)
    # Served everywhere, any address will do: none can be made to point here.
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
    """Have a server that is started meanwhile at a host refuse all others' requests.

    viser has no setting for that: its server is given the check where it asks for one.
    """
    serve = server.serve

    def guarded(*args: Any, process_request: Any = None, **given: Any) -> Any:
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

        return serve(*args, process_request=check, **given)

    server.serve = guarded  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]


def turns_others_away(host: str, port: int) -> bool:
    """Whether the server at a host and port refuses the websocket to a page of another site.

    Asked for from outside, for a later viser may start its server in a way that takes no check.
    """
    connection = http.client.HTTPConnection(host, port, timeout=_CHECK_S)
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

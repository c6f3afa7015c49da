"""Who may see the page and who may act: Host, Origin and token.

A page of another site must not reach the dashboard through the browser of somebody who can: its
Origin is another one. Nor may a foreign name that was made to resolve to this machine (DNS
rebinding): names in Host are a short list, and an address cannot be made to mean another machine.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from typing import Final
from urllib.parse import urlsplit

TOKEN_BYTES: Final = 18
TOKEN_LENGTH_MIN: Final = 16
"""Of a token that a user chooses: nobody guesses it within a car's life."""
LOCAL_NAMES: Final = frozenset({"localhost"})


def new_token() -> str:
    """A token that nobody has had before."""
    return secrets.token_urlsafe(TOKEN_BYTES)


class Access:
    """What is checked before anything is answered.

    Args:
        token: Opens the controls.
        names: Host names under which the dashboard is reached, beside `localhost` and addresses.
    """

    def __init__(self, token: str, names: frozenset[str] = frozenset()) -> None:
        assert len(token) >= TOKEN_LENGTH_MIN
        self.token = token
        self._names = LOCAL_NAMES | {name.lower() for name in names}

    def is_token(self, given: object) -> bool:
        """Whether it is the token; takes as long for a wrong one as for the right one."""
        if not isinstance(given, str):
            return False
        return hmac.compare_digest(given.encode("utf-8", "replace"), self.token.encode())

    def is_own_host(self, host: str) -> bool:
        """Whether a request's Host is an address, or a name of ours."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if f"//{host}" != f"//{host}".strip() or any(mark in host for mark in "/?#@\\"):
            return False
        return name in self._names or _is_address(name)

    def is_own_origin(self, origin: str, host: str) -> bool:
        """Whether a page that opens a WebSocket was served under this very host and port."""
        return self.is_own_host(host) and origin.lower() in (
            f"http://{host.lower()}", f"https://{host.lower()}",
        )  # fmt: skip


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches what listens there."""
    return host in LOCAL_NAMES or (_is_address(host) and ipaddress.ip_address(host).is_loopback)


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True

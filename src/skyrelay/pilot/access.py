"""Who may reach a server of ours: this machine, or whoever carries its token."""

from __future__ import annotations

import base64
import hmac

from skyrelay.core.errors import UsageError


class Access:
    """Where a server listens, and what a request must carry.

    Args:
        listen: ``HOST:PORT``; port 0 takes any.
        token: that every request must carry, as a bearer or as the password of basic authentication; None for none,
            which only loopback allows.
        option: that ``listen`` is of, for messages.
    Raises:
        UsageError: the address is none, or is not loopback and there is no token.
    """

    def __init__(self, listen: str, token: str | None, option: str) -> None:
        host, colon, port = listen.rpartition(":")
        if not (colon and host and port.isascii() and port.isdigit() and int(port) < 1 << 16):
            raise UsageError(option, listen, "HOST:PORT, e.g. 127.0.0.1:8545")
        if token is None and not (host in ("localhost", "::1") or host.startswith("127.")):
            raise UsageError(option, listen, "a loopback address, or a token for those who call from elsewhere")
        self.address = (host, int(port))
        self._token = token

    def allows(self, authorization: str | None) -> bool:
        """Whether a request with this header may be answered."""
        if self._token is None:
            return True
        scheme, _, given = (authorization or "").partition(" ")
        if scheme.lower() == "basic":
            try:
                given = base64.b64decode(given, validate=True).decode().partition(":")[2]
            except ValueError:
                return False
        return hmac.compare_digest(given.encode(), self._token.encode())

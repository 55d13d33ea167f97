"""Access rules for the page and the metrics. Rules only: no socket, no clock of its own.

On loopback everybody on this machine has access; anywhere else the token is needed. Two rules
protect against foreign pages in the same browser: requests with a host name that is not of this
machine are rejected (DNS rebinding), and so are requests whose Origin is another page.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import secrets
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple
from urllib.parse import urlsplit

from gateway.settings.config import ConfigError

LEAST_TOKEN: Final = 16
LEAST_KINDS: Final = 6
"""Least number of different characters of a token; nothing else shows how random it is."""
WRONG_MOST: Final = 10
WRONG_WINDOW_S: Final = 60.0
ADDRESSES: Final = 1024
LOOPBACK_NAMES: Final = ("127.0.0.1", "localhost", "::1")


class Listen(NamedTuple):
    """Address to listen at; host as for `bind`, without brackets."""

    host: str
    port: int

    def __str__(self) -> str:
        """The address as in a URL."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}"


def listen(text: str, default: Listen) -> Listen:
    """Parse HOST:PORT, HOST or PORT; missing parts are those of `default`. Raises ValueError."""
    if text.isascii() and text.isdigit():
        host, port = default.host, text
    else:
        try:
            ipaddress.IPv6Address(text.strip("[]"))
            host, port = text.strip("[]"), ""
        except ValueError:
            host, _, port = text.rpartition(":") if ":" in text else (text, "", "")
            host = host.strip("[]")
    number = int(port) if port.isascii() and port.isdigit() else default.port if not port else -1
    if not host or not 0 <= number <= 65535 or "/" in host:
        raise ValueError(f"{text!r} is not HOST:PORT")
    return Listen(host, number)


def token_of(content: bytes, name: str) -> bytes:
    """The token in a file, without surrounding white space. Raises ConfigError."""
    token = content.strip()
    problems = []
    if len(token) < LEAST_TOKEN:
        few = f"{len(token)} bytes are too short for a token"
        problems.append(f"{few}; at least {LEAST_TOKEN} are needed")
    elif len(set(token)) < LEAST_KINDS:
        problems.append("too few different characters for a token")
    if not all(0x21 <= byte <= 0x7E for byte in token):
        problems.append("a token is printable ASCII without spaces")
    if problems:
        cure = f"make one: traction-gateway keygen --token -o {name}"
        raise ConfigError(name, ["; ".join([*problems, cure])])
    return token


class Wrong:
    """Wrong tokens by address: after `WRONG_MOST` of them the address has to wait. Bounded."""

    def __init__(self) -> None:
        self._by: OrderedDict[str, tuple[float, int]] = OrderedDict()

    def waits_s(self, address: str, now_s: float) -> float:
        """Time that this address has to wait; 0 if its token will be checked."""
        begin, count = self._by.get(_who(address), (now_s, 0))
        left = begin + WRONG_WINDOW_S - now_s
        return left if count >= WRONG_MOST and left > 0 else 0.0

    def note(self, address: str, now_s: float) -> None:
        """Count a wrong token."""
        who = _who(address)
        begin, count = self._by.pop(who, (now_s, 0))
        if now_s - begin >= WRONG_WINDOW_S:
            begin, count = now_s, 0
        self._by[who] = begin, count + 1
        while len(self._by) > ADDRESSES:
            self._by.popitem(last=False)


def _who(address: str) -> str:
    """Key of an address: for IPv6 its /64 network, all of whose addresses a host may use."""
    try:
        parsed = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(parsed, ipaddress.IPv6Address) and parsed.ipv4_mapped is None:
        return str(ipaddress.ip_network((parsed, 64), strict=False))
    return str(parsed)


class Refusal(NamedTuple):
    """Rejection of a request, as an HTTP response. cause: name of the counter."""

    status: int
    cause: str
    text: str
    headers: tuple[tuple[str, str], ...] = ()


class Access:
    """The rules for one server. It keeps the digest of the token, not the token."""

    def __init__(self, token: bytes | None = None, names: Iterable[str] = ()) -> None:
        """token: None admits everybody who reaches the address. names: of hosts, besides loopback.

        With a token any numeric address counts as a name of this machine: DNS cannot fake numeric
        addresses, and a server bound to all addresses does not know by which it is reached.
        """
        self._digest = None if token is None else hashlib.sha256(token).digest()
        # The cookie is not the token: it goes to every port of the host, and ends with the process.
        self.session = (
            "" if token is None
            else hmac.new(token, secrets.token_bytes(32), "sha256").hexdigest()
        )  # fmt: skip
        """Content of the cookie of a person who has given the token."""
        self._names = {*LOOPBACK_NAMES, *(name.lower() for name in names)}
        self._wrong = Wrong()

    @property
    def wants_token(self) -> bool:
        """Whether a token is needed."""
        return self._digest is not None

    def page(self, headers: Mapping[str, str]) -> Refusal | None:
        """None if Host and Origin name this machine. headers: names in lower case."""
        host = headers.get("host", "")
        if not self._ours(host):
            cure = "use the IP address" if self.wants_token else "use 127.0.0.1"
            return Refusal(403, "host", f"this is not a name of this machine; {cure}")
        ours = {f"{scheme}://{host}".lower() for scheme in ("http", "https")}
        if headers.get("origin", f"http://{host}").lower() not in ours:
            return Refusal(403, "origin", "the request comes from a page of another origin")
        return None

    def person(
        self, headers: Mapping[str, str], given: str | None, cookie: str, address: str, now_s: float
    ) -> Refusal | None:
        """None if no token is needed, or the right one is given.

        given: token in the URL; if None, that of the header is used. cookie: its content. It is
        checked even after too many wrong tokens from this address: nobody can guess 256 bits.
        """
        if self._digest is None:
            return None
        if given is None and _is(cookie, self.session):
            return None
        if given is None:
            scheme, _, given = headers.get("authorization", "").partition(" ")
            given = given.strip() if scheme.lower() == "bearer" else ""
        unknown = (("www-authenticate", 'Bearer realm="traction-gateway"'),)
        if not given:
            text = "a token is required: 'Authorization: Bearer TOKEN', or once /?token=TOKEN"
            return Refusal(401, "no_token", text, unknown)
        if waits := self._wrong.waits_s(address, now_s):
            again = (("retry-after", str(int(waits) + 1)),)
            return Refusal(429, "too_many", "too many wrong tokens; wait a minute", again)
        seen = hashlib.sha256(given.encode("utf-8", "surrogatepass")).digest()
        if hmac.compare_digest(seen, self._digest):
            return None
        self._wrong.note(address, now_s)
        return Refusal(401, "wrong_token", "wrong token", unknown)

    def _ours(self, host: str) -> bool:
        name = _name(host)
        if name is None:
            return False
        if name in self._names:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return self.wants_token


def _name(host: str) -> str | None:
    """The name in a Host header; None if it holds anything but a name and a port."""
    if not host or any(c in host for c in "/@?#\\ ,"):
        return None
    try:
        parts = urlsplit(f"//{host}")
        _ = parts.port
    except ValueError:
        return None
    return parts.hostname


def _is(given: str, expected: str) -> bool:
    return bool(expected) and hmac.compare_digest(given.encode(errors="replace"), expected.encode())

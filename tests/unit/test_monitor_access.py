"""Who may look: every rule allowed once and refused once."""

import pytest

from gateway.monitor.model.access import (
    ADDRESSES,
    WRONG_MOST,
    WRONG_WINDOW_S,
    Access,
    Listen,
    Wrong,
    listen,
    token_of,
)
from gateway.settings.config import ConfigError

TOKEN = b"s3cret-Token-of-32-characters-ab"
DEFAULT = Listen("127.0.0.1", 8090)


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("8100", "127.0.0.1", 8100), ("0.0.0.0:81", "0.0.0.0", 81), ("bench-3", "bench-3", 8090),
        ("::1", "::1", 8090), ("[::1]:9", "::1", 9), ("localhost:0", "localhost", 0),
    ],
)  # fmt: skip
def test_addresses(text, host, port):
    assert listen(text, DEFAULT) == Listen(host, port)


@pytest.mark.parametrize("text", ["", ":80", "a:b", "a:70000", "99999", "a:-1", "logs/a.log:x"])
def test_what_is_no_address(text):
    with pytest.raises(ValueError, match="HOST:PORT"):
        listen(text, DEFAULT)


def test_an_address_is_written_as_in_an_address_line():
    assert str(Listen("::1", 9)) == "[::1]:9"
    assert str(DEFAULT) == "127.0.0.1:8090"


def test_a_token_is_long_enough_and_no_pattern():
    assert token_of(b"  " + TOKEN + b"\n", "t") == TOKEN
    for bad, why in (
        (TOKEN[:15], "15 bytes"),
        (b"", "0 bytes"),
        (b"aaaaaaaaaaaaaaaaaaaaaaaa", "too few"),
        (b"two words and more of it", "without spaces"),
        (TOKEN + b"\xff", "printable"),
    ):
        with pytest.raises(ConfigError, match=why) as raised:
            token_of(bad, "t")
        assert "keygen --token" in str(raised.value)
        assert not bad or repr(bad) not in str(raised.value)


@pytest.mark.parametrize(
    ("host", "local", "with_token"),
    [
        ("127.0.0.1:8090", True, True), ("localhost", True, True), ("LOCALHOST:1", True, True),
        ("[::1]:8090", True, True), ("10.1.2.3:8090", False, True), ("[fe80::1]:8090", False, True),
        ("bench-3:8090", False, True), ("evil.example", False, False),
        ("127.0.0.1.evil.example", False, False), ("localhost.", False, False),
        ("user@127.0.0.1", False, False), ("127.0.0.1:x", False, False),
        ("127.0.0.1/..", False, False), ("127.0.0.1, evil.example", False, False),
        ("", False, False),
    ],
)  # fmt: skip
def test_names_of_this_machine(host, local, with_token):
    assert (Access().page({"host": host}) is None) is local
    assert (Access(TOKEN, ["bench-3"]).page({"host": host}) is None) is with_token


def test_no_name_at_all_is_refused():
    refusal = Access().page({})
    assert refusal is not None
    assert (refusal.status, refusal.cause) == (403, "host")


@pytest.mark.parametrize(
    ("origin", "good"),
    [
        (None, True), ("http://127.0.0.1:8090", True), ("https://127.0.0.1:8090", True),
        ("http://127.0.0.1:8091", False), ("http://localhost:8090", False),
        ("http://evil.example", False), ("null", False), ("", False), ("file://", False),
        ("ftp://127.0.0.1:8090", False),
    ],
)  # fmt: skip
def test_pages_from_elsewhere(origin, good):
    headers = {"host": "127.0.0.1:8090"} | ({} if origin is None else {"origin": origin})
    refusal = Access().page(headers)
    assert (refusal is None) is good
    assert good or refusal.cause == "origin"


def asked(access, *, header=None, given=None, cookie="", now=0.0, address="10.0.0.9"):
    headers = {} if header is None else {"authorization": header}
    return access.person(headers, given, cookie, address, now)


def test_without_a_token_everybody_may():
    assert asked(Access()) is None


def test_the_token_in_the_header_or_in_the_address_line():
    access = Access(TOKEN)
    text = TOKEN.decode()
    assert asked(access, header=f"Bearer {text}") is None
    assert asked(access, header=f"bearer  {text}") is None
    assert asked(access, given=text) is None
    for wrong in (f"Bearer {text}x", f"Bearer {text[:-1]}", "Bearer ä€"):
        refusal = asked(access, header=wrong)
        assert (refusal.status, refusal.cause) == (401, "wrong_token")
    for none in (None, "Bearer", "Bearer ", f"Basic {text}", text):
        refusal = asked(access, header=none)
        assert (refusal.status, refusal.cause) == (401, "no_token")
        assert dict(refusal.headers)["www-authenticate"].startswith("Bearer")
    # A wrong one in the address line is wrong, whatever the header says.
    assert asked(access, given="no", header=f"Bearer {text}").status == 401


def test_the_cookie_is_not_the_token_and_not_that_of_another_start():
    access, other = Access(TOKEN), Access(TOKEN)
    assert asked(access, cookie=access.session) is None
    for wrong in (other.session, TOKEN.decode(), "", "\x00", "\ud800", "\xe4"):
        assert asked(access, cookie=wrong).status == 401
    assert TOKEN.decode() not in access.session
    assert Access().session == ""


def test_wrong_tokens_are_limited_by_address_and_time():
    access = Access(TOKEN)
    right = f"Bearer {TOKEN.decode()}"
    for k in range(WRONG_MOST):
        assert asked(access, header="Bearer no", now=k).status == 401
    refusal = asked(access, header=right, now=WRONG_MOST)
    assert (refusal.status, refusal.cause) == (429, "too_many"), "nor is the right one looked at"
    assert int(dict(refusal.headers)["retry-after"]) == WRONG_WINDOW_S - WRONG_MOST + 1
    assert asked(access, header=right, now=WRONG_MOST, address="10.0.0.8") is None
    assert asked(access, cookie=access.session, now=WRONG_MOST) is None
    assert asked(access, header=right, now=WRONG_WINDOW_S) is None


def test_asking_without_a_token_uses_up_nothing():
    access = Access(TOKEN)
    for _ in range(3 * WRONG_MOST):
        assert asked(access).status == 401
    assert asked(access, header=f"Bearer {TOKEN.decode()}") is None


def test_wrong_tokens_of_many_addresses_take_bounded_memory():
    wrong = Wrong()
    for k in range(ADDRESSES + 500):
        wrong.note(f"10.{k >> 8}.{k & 255}.1", 0.0)
    assert len(wrong._by) == ADDRESSES
    for k in range(WRONG_MOST):
        wrong.note(f"2001:db8::{k}", 0.0)
    assert wrong.waits_s("2001:db8::ffff", 0.0) > 0, "a host has its whole network"
    assert wrong.waits_s("2001:db8:1::1", 0.0) == 0
    assert wrong.waits_s("fe80::1%eth0", 0.0) == 0

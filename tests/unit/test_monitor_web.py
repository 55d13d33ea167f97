"""The page's server: each rule of security allowed and refused, real sockets for slow readers."""

import hashlib
import json
import re
import socket
import time
from contextlib import contextmanager, suppress

import can
import pytest
from starlette.testclient import TestClient, WebSocketDenialResponse
from starlette.websockets import WebSocketDisconnect

from gateway.cli import main
from gateway.monitor import web
from gateway.monitor.feed import Feed
from gateway.monitor.model.access import WRONG_MOST, Access, Listen, token_of
from gateway.monitor.model.snapshot import Event
from gateway.monitor.web import STATIC, bind, is_loopback, make_app
from gateway.settings.config import ConfigError
from tests.watched import FakeSource, server_of, until

TOKEN = "s3cret-Token-of-32-characters-ab"
BASE = "http://127.0.0.1:8090"
LOOK = "ws://127.0.0.1:8090/look"


@contextmanager
def client_of(feed=None, token=None, base=BASE, address="10.0.0.9", **options):
    feed = feed or Feed(FakeSource())
    app = make_app(feed, Access(token and token.encode()), **options)
    with TestClient(app, base_url=base, client=(address, 5), follow_redirects=False) as client:
        yield client


def look(client, **headers):
    """One message of the websocket."""
    with client.websocket_connect(LOOK, headers=headers) as viewer:
        return json.loads(viewer.receive_text())


def test_the_page_its_files_pictures_and_metrics():
    with client_of() as client:
        page = client.get("/")
        assert page.status_code == 200
        files = re.findall(r'(?:src|href)="(/[^"]+)"', page.text)
        assert len(files) >= 5
        for name in files:
            assert client.get(name).status_code == 200, name
        assert look(client)["head"]["title"] == "a.log"
        metrics = client.get("/metrics")
        assert metrics.status_code == 200
        assert metrics.headers["content-type"].startswith("text/plain; version=")
        assert client.get("/nothing").status_code == 404


def test_only_get():
    with client_of() as client:
        for verb in ("POST", "PUT", "DELETE", "PATCH", "OPTIONS", "HEAD", "TRACE", "PROPFIND"):
            for path in ("/", "/metrics", "/static/page.js", "/look"):
                answer = client.request(verb, path)
                assert answer.status_code == 405, (verb, path)
                assert answer.headers["allow"] == "GET"
        assert client.get("/").status_code == 200


def test_nothing_outside_the_static_folder_is_served():
    with client_of() as client:
        for path in (
            "/static/../web.py", "/static/%2e%2e/web.py", "/static/..%2fweb.py",
            "/static//etc/passwd", "/static/%2fetc/passwd", "/static/", "/static/vendor",
        ):  # fmt: skip
            assert client.get(path).status_code in (404, 405), path
        assert client.get("/static/vendor/uPlot.LICENSE").status_code == 200


def test_a_browser_is_told_to_run_nothing_else():
    with client_of(token=TOKEN) as client:
        for answer in (client.get("/"), client.get("/metrics"), client.post("/")):
            policy = answer.headers["content-security-policy"]
            assert "default-src 'none'" in policy
            assert "frame-ancestors 'none'" in policy
            assert "unsafe" not in policy
            assert answer.headers["x-content-type-options"] == "nosniff"
            assert answer.headers["referrer-policy"] == "no-referrer"
            assert answer.headers["cross-origin-resource-policy"] == "same-origin"
            assert answer.headers["cache-control"] == "no-store"


def test_the_page_has_no_inline_script_or_style_and_nothing_from_elsewhere():
    page = (STATIC / "index.html").read_text()
    assert not re.search(r"<script(?![^>]*\bsrc=)", page)
    assert not re.search(r"<style|\sstyle=|\son\w+=|javascript:", page)
    for path in (STATIC / "index.html", *STATIC.glob("*.js"), *STATIC.glob("*.css")):
        text = path.read_text()
        assert not re.search(r"(https?:)?//[a-z0-9.-]+\.[a-z]{2,}", text), path.name
        assert not re.search(r"\beval\(|new Function|innerHTML|insertAdjacentHTML", text), path.name


def test_the_code_of_others_is_what_its_list_says():
    folder = STATIC / "vendor"
    listed = re.findall(r"`(uPlot\.\S+)`.*`([0-9a-f]{64})`", (folder / "README.md").read_text())
    assert {name for name, _ in listed} == {p.name for p in folder.iterdir()} - {"README.md"}
    for name, expected in listed:
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == expected, name


@pytest.mark.parametrize("name", ["evil.example", "evil.example:8090", "10.1.2.3:8090", ""])
def test_other_names_are_refused(name):
    """DNS rebinding: a page of evil.example, whose name now leads here."""
    with client_of() as client:
        for path in ("/", "/metrics", "/static/page.js"):
            assert client.get(path, headers={"host": name}).status_code == 403
        with pytest.raises(WebSocketDenialResponse) as refused:
            look(client, host=name)
        assert refused.value.status_code == 403


def test_two_names_are_refused():
    with client_of() as client:
        twice = [("host", "127.0.0.1:8090"), ("host", "evil.example")]
        assert client.get("/", headers=twice).status_code == 400


def test_a_websocket_of_another_page_is_refused():
    with client_of() as client:
        assert look(client)["head"], "no browser, no origin"
        assert look(client, origin=BASE)["head"]
        for origin in ("http://evil.example", "null", "http://127.0.0.1:8091"):
            with pytest.raises(WebSocketDenialResponse) as refused:
                look(client, origin=origin)
            assert refused.value.status_code == 403
            assert client.get("/metrics", headers={"origin": origin}).status_code == 403


def test_a_token_in_the_header():
    with client_of(token=TOKEN) as client:
        right, wrong = {"authorization": f"Bearer {TOKEN}"}, {"authorization": "Bearer no"}
        for path in ("/", "/metrics", "/static/page.js"):
            assert client.get(path, headers=right).status_code == 200
            assert client.get(path, headers=wrong).status_code == 401
            assert client.get(path).status_code == 401
        assert look(client, **right)["head"]
        for headers in ({}, wrong):
            with pytest.raises(WebSocketDenialResponse) as refused:
                look(client, **headers)
            assert refused.value.status_code == 401


def test_a_token_in_the_address_line_becomes_a_cookie_once():
    with client_of(token=TOKEN) as client:
        answer = client.get(f"/?token={TOKEN}")
        assert (answer.status_code, answer.headers["location"]) == (303, "/")
        cookie = answer.headers["set-cookie"]
        assert cookie.startswith("traction_gateway_8090=")
        assert "HttpOnly" in cookie
        assert "samesite=strict" in cookie.lower()
        assert TOKEN not in cookie
        assert client.get("/").status_code == 200
        assert look(client)["head"]
    with client_of(token=TOKEN) as client:
        assert client.get("/?token=no").status_code == 401
        assert client.get("/?token=").status_code == 401
        assert client.get(f"/metrics?token={TOKEN}").status_code == 401, "only where one comes in"
        assert "set-cookie" not in client.get("/?token=no").headers
    with client_of() as client:
        answer = client.get(f"/?token={TOKEN}")
        assert answer.status_code == 200
        assert "set-cookie" not in answer.headers


def test_a_session_is_found_among_other_cookies_and_odd_ones_break_nothing():
    app = make_app(Feed(FakeSource()), access := Access(TOKEN.encode()))
    name = "traction_gateway_8090"
    with TestClient(app, base_url=BASE) as client:
        for right in (f"x=y; {name}={access.session}", f'=; ;{name}="{access.session}";'):
            assert client.get("/", headers={"cookie": right}).status_code == 200, right
        for wrong in (
            f"{name}={TOKEN}",
            f"{name}=",
            f"{name}=\x01; ;;=",
            f"tg={access.session}",
            ";",
        ):
            assert client.get("/", headers={"cookie": wrong}).status_code == 401, wrong


def test_wrong_tokens_are_limited():
    feed = Feed(FakeSource())
    with client_of(feed, token=TOKEN) as client:
        for _ in range(WRONG_MOST):
            assert client.get("/?token=no").status_code == 401
        answer = client.get(f"/?token={TOKEN}")
        assert answer.status_code == 429
        assert 0 < int(answer.headers["retry-after"]) <= 61
    assert feed.counts["wrong_token"] == WRONG_MOST
    assert feed.counts["too_many"] == 1


def test_only_so_many_viewers():
    feed = Feed(FakeSource())
    with client_of(feed, most=2) as client:
        with client.websocket_connect(LOOK) as one, client.websocket_connect(LOOK) as two:
            assert one.receive_text()
            assert two.receive_text()
            with client.websocket_connect(LOOK) as three:
                with pytest.raises(WebSocketDisconnect) as closed:
                    three.receive_text()
                assert closed.value.code == web.TOO_MANY
        assert look(client)["head"], "and one again when they have left"
    assert feed.counts["too_many_viewers"] == 1


def closed_by(client, *texts):
    """The code with which the websocket is closed after a viewer has said this."""
    with client.websocket_connect(LOOK) as viewer:
        for text in texts:
            viewer.send_bytes(text) if isinstance(text, bytes) else viewer.send_text(text)
        try:
            for _ in range(1000):
                viewer.receive_text()
        except WebSocketDisconnect as closed:
            return closed.code
    return None


@pytest.mark.parametrize(
    "text",
    [
        "",
        "x",
        "[" * 200,
        '{"seek":NaN}',
        '{"send":"181#00"}',
        '{"seek":1,"x":2}',
        '"pause"',
        b"\x00",
    ],
)
def test_what_no_page_says_ends_it(text):
    feed = Feed(FakeSource())
    with client_of(feed) as client:
        assert closed_by(client, text) == web.NOT_UNDERSTOOD
    assert feed.counts["bad_request"] == 1


def test_who_asks_too_often_is_sent_away():
    with client_of() as client:
        assert closed_by(client, *['{"seek":1}'] * 2000) == web.TOO_FAST


def test_seek_pause_and_speed_reach_the_log():
    source = FakeSource()
    with client_of(Feed(source)) as client, client.websocket_connect(LOOK) as viewer:
        viewer.send_text('{"pause":true}')
        viewer.send_text('{"speed":5}')
        viewer.send_text('{"seek":30}')
        for _ in range(600):
            head = json.loads(viewer.receive_text())["head"]
            if head["t_s"] == 30.0:
                break
    assert (head["t_s"], head["paused"], head["speed"]) == (30.0, True, 5.0)


def test_nothing_that_a_page_sends_reaches_a_bus():
    from gateway.io.bus import open_transport
    from gateway.io.permission import Mode, allowed
    from gateway.io.prepare import prepare
    from gateway.monitor.model.observer import Observer
    from gateway.monitor.sources import LiveSource

    config, codec = prepare(None)
    options = {"interface": "virtual", "channel": "page"}
    with can.Bus("page", interface="virtual") as other:
        transport = open_transport(options, allowed(Mode.LISTEN, config, codec))
        source = LiveSource(transport, Observer(codec, config), "page")
        try:
            with client_of(Feed(source)) as client:
                for text in ('{"seek":1}', '{"pause":true}', '{"speed":9}'):
                    with client.websocket_connect(LOOK) as viewer:
                        viewer.send_text(text)
                        assert json.loads(viewer.receive_text())["head"]["live"]
                closed_by(client, '{"send":"181#00"}')
                client.post("/", content=b"181#00")
            assert other.recv(0.3) is None
            assert (source.paused, source.speed) == (False, 1.0)
        finally:
            source.close()


def test_metrics_alone_have_a_port_of_their_own():
    with client_of(metrics_only=[8091], base="http://127.0.0.1:8091") as client:
        assert client.get("/metrics").status_code == 200
        assert client.get("/").status_code == 404
        assert client.get("/static/page.js").status_code == 404
        with (
            pytest.raises((WebSocketDisconnect, WebSocketDenialResponse)),
            client.websocket_connect("ws://127.0.0.1:8091/look"),
        ):
            pass
    with client_of(page=False) as client:
        assert client.get("/metrics").status_code == 200
        assert client.get("/").status_code == 404


def test_what_stops_the_feed_stops_the_server():
    def broken(_):
        raise RuntimeError("broken")

    told = []
    with client_of(Feed(FakeSource(make=broken)), ended=told.append):
        until(lambda: told)
    assert [str(error) for error in told] == ["broken"]


def opened(port, room):
    """A viewer that reads the handshake's answer, and nothing after it."""
    made = socket.socket()
    made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, room)
    made.settimeout(10)
    made.connect(("127.0.0.1", port))
    made.sendall(
        f"GET /look HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        "Sec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    assert made.recv(12) == b"HTTP/1.1 101"
    return made


class Fat(FakeSource):
    """Each picture is large, and none like the other."""

    def advance(self, wall_dt_s):
        shown = super().advance(wall_dt_s)
        text = f"{self.t_s} " + "x" * 50_000
        return shown._replace(events=(Event(self.t_s, "info", None, text),))


def in_time(attempt, first_s):
    """On a machine that stands still a good viewer, too, misses a limit, but no long one."""
    for limit_s in (first_s, 8 * first_s):
        with suppress(AssertionError, OSError):
            return attempt(limit_s)
    return attempt(64 * first_s)


def test_who_does_not_read_is_dropped_and_disturbs_nobody():
    in_time(one_of_two_is_dropped, 0.5)


def one_of_two_is_dropped(read_s):
    feed = Feed(Fat())
    stuck_ms = round(2000 * read_s)
    with server_of(feed, stuck_ms=stuck_ms, read_s=read_s) as (server, port), opened(port, 4096):
        until(lambda: feed.viewers == 1)
        with opened(port, 4096) as reader:
            got = 0
            while not feed.counts["slow"]:
                got += len(reader.recv(65536))
            until(lambda: feed.viewers < 2)
            assert feed.counts["slow"] == 1
            assert feed.viewers == 1, "the one that reads stays"
            before = feed.picture.number
            until(lambda: feed.picture.number > before + 3)
            assert got > 100_000
        # Nobody reads, so no word of farewell gets through: the kernel gives it up.
        until(lambda: not server.server_state.connections)


def test_a_viewer_that_leaves_is_forgotten():
    feed = Feed(FakeSource())
    with server_of(feed) as (server, port):
        for _ in range(20):
            with opened(port, 4096):
                until(lambda: feed.viewers == 1)
            until(lambda: feed.viewers == 0)
        until(lambda: not server.server_state.connections)
    assert not feed.counts


def test_large_messages_of_a_viewer_are_not_taken():
    feed = Feed(FakeSource())
    with server_of(feed) as (_, port), opened(port, 65536) as viewer:
        viewer.sendall(b"\x81\xfe\x40\x00" + b"\0" * 4 + b" " * 0x4000)  # 16 kB of text, masked
        until(lambda: feed.viewers == 0)
        assert not feed.counts


HOST = b"Host: localhost\r\n"


@pytest.mark.parametrize(
    "sent",
    [
        b"", b"G", b"GET / HTTP/1.1\r\n", b"GET / HTTP/1.1\r\n" + HOST,
        b"GET / HTTP/1.1\r\n" + HOST + b"Content-Length: 9\r\n\r\nabc",
        b"GET /look HTTP/1.1\r\n" + HOST + b"Upgrade: websocket\r\nConnection: Upg",
        b"GET / HTTP/1.1\r\n" + HOST + b"\r\nGET /metr",
    ],
    ids=["nothing", "a byte", "a line", "a header", "a body", "an upgrade", "the second request"],
)  # fmt: skip
def test_a_request_that_is_never_whole_is_given_up(sent):
    """Also of one that drips on: only a whole request counts."""
    feed = Feed(FakeSource())
    with server_of(feed, request_s=0.3) as (server, port):
        with socket.create_connection(("127.0.0.1", port), timeout=20.0) as half:
            half.sendall(sent)
            half.setblocking(False)
            until(lambda: drips(half))
        until(lambda: not server.server_state.connections)
    assert feed.counts == {"half_sent": 1}


def drips(half):
    """Send one more byte and read on; whether the other end has closed."""
    try:
        half.send(b"x")
    except OSError:
        return True
    try:
        while half.recv(65536):
            pass
    except BlockingIOError:
        return False
    except OSError:
        pass
    return True


def test_all_connections_half_sent_keep_nobody_out_for_long():
    in_time(all_half_sent, 0.3)


def all_half_sent(request_s):
    feed = Feed(FakeSource())
    with server_of(feed, request_s=request_s) as (_, port):
        halves = [socket.create_connection(("127.0.0.1", port)) for _ in range(web.CONNECTIONS)]
        for half in halves:
            half.sendall(b"GET / HT")
        until(lambda: feed.counts["half_sent"] == web.CONNECTIONS)
        with opened(port, 4096):
            until(lambda: feed.viewers == 1)
        for half in halves:
            half.close()
    assert feed.counts == {"half_sent": web.CONNECTIONS}


def test_whole_requests_and_pauses_between_them_are_no_half_sent_ones():
    in_time(whole_with_pauses, 0.3)


def whole_with_pauses(request_s):
    feed = Feed(FakeSource())
    ask = b"GET /metrics HTTP/1.1\r\n" + HOST + b"\r\n"
    with server_of(feed, request_s=request_s) as (_, port), opened(port, 65536):
        until(lambda: feed.viewers == 1)
        with socket.create_connection(("127.0.0.1", port), timeout=20.0) as asker:
            for _ in range(2):
                for part in (ask[:10], ask[10:]):
                    asker.sendall(part)
                assert asker.recv(12) == b"HTTP/1.1 200"
                time.sleep(1.5 * request_s)
                asker.recv(1 << 20)
        assert feed.viewers == 1
        assert not feed.counts


def test_loopback_is_told_from_what_others_can_reach():
    for host in ("127.0.0.1", "127.8.9.1", "localhost", "::1"):
        assert is_loopback(Listen(host, 1)), host
    for host in ("0.0.0.0", "::", "10.1.2.3", "192.0.2.1", "::ffff:10.0.0.1"):
        assert not is_loopback(Listen(host, 1)), host
    with pytest.raises(ConfigError, match="cannot be resolved"):
        is_loopback(Listen("no-such-host.invalid", 1))


def test_a_port_in_use_is_told():
    with bind(Listen("127.0.0.1", 0)) as made:
        made.listen()
        where = Listen("127.0.0.1", made.getsockname()[1])
        with pytest.raises(ConfigError, match="in use; name another port"):
            bind(where)


@pytest.mark.parametrize(
    ("words", "cure"),
    [
        (["--web", "0.0.0.0:0"], "keygen --token"),
        (["--web", "[::]:0"], "--token-file FILE"),
        (["--metrics", "192.0.2.7:0"], "keygen --token"),
        (["--web", "127.0.0.1:0", "--metrics", "0.0.0.0:0"], "0.0.0.0:0"),
        (["--web", "127.0.0.1:x"], "HOST:PORT"),
        (["--web", "no-such-host.invalid"], "cannot be resolved"),
        (["--web", "a.log"], "monitor a.log --web"),
        (["--web", "--token-file", "open"], "chmod 600"),
        (["--web", "--token-file", "short"], "at least 16 are needed"),
        (["--web", "--token-file", "none"], "cannot be read"),
        (["--token-file", "good"], "without --web"),
    ],
)
def test_addresses_and_tokens_on_the_command_line(tmp_path, monkeypatch, refused, words, cure):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.log").write_text("")
    for name, text, mode in (
        ("open", TOKEN, 0o644), ("short", "abc", 0o600), ("good", TOKEN, 0o600),
    ):  # fmt: skip
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(mode)
    said = refused("monitor", *words)
    assert cure in said
    assert TOKEN not in said


def test_a_token_as_a_credential_of_the_service_manager(tmp_path, monkeypatch, capsys):
    (tmp_path / "web.token").write_text(TOKEN)
    words = ["monitor", "none.log", "--web", "0.0.0.0:0", "--token-file", "web.token"]
    # First the token is missing; once it is taken, the log is.
    for missing in ("web.token", "none.log"):
        assert main(words) == 2
        assert missing in capsys.readouterr().err.splitlines()[-1]
        monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))


def test_a_token_can_be_made(tmp_path):
    made = tmp_path / "web.token"
    words = ["keygen", "--token", "-o", str(made)]
    assert main(words) == 0
    assert made.stat().st_mode & 0o777 == 0o600
    assert len(token_of(made.read_bytes(), "x")) >= 43
    assert main(words) == 2, "never over one"

"""The page in real headless Chromium, on a replayed log: what it shows, keys, sizes, contrast."""

import json
import re
import urllib.request
from contextlib import suppress
from pathlib import Path

from playwright.sync_api import expect

from gateway.monitor.feed import Feed
from gateway.monitor.log_source import LogSource
from gateway.monitor.model.snapshot import Event, as_json
from tests.monitored import SECONDS, recorded
from tests.simrun import log_of
from tests.watched import FakeSource, server_of, snapshot, until
from tests.web.conftest import DESK, PHONE, monitor

SIGNS = {"✓", "✗", "?", "!", "·"}
CONTRAST = (Path(__file__).parent / "contrast.js").read_text()
LOST_S = 1.8
"""Drive 2 has lost adhesion then."""


def show(page, t_s):
    """Stand still at a time of the log."""
    until(lambda: stands(page))
    page.locator("#slider").fill(str(t_s))
    expect(page.locator("#now")).to_have_text(f"{t_s:.1f}")


def stands(page):
    """Ask for it; where the log has come to its end by then, it begins anew instead."""
    play = page.locator("#play")
    if play.inner_text() == "Pause":
        play.click()
        with suppress(AssertionError):
            expect(play).to_have_text("Play", timeout=2000)
    return play.inner_text() == "Play"


def value(page, where, key):
    return page.locator(f"{where} dd[data-key={key}]").inner_text()


def figure(number, digits, unit=""):
    if number is None:
        return "?"
    return f"{number:.{digits}f}{' ' + unit if unit else ''}"


def flag(page, where, key):
    return page.locator(f"{where} .flag[data-key={key}]").inner_text()


def test_every_panel_says_what_the_observer_says(opened, address, log):
    page = opened(address)
    show(page, LOST_S)
    said = as_json(LogSource(log, recorded().observer).seek(LOST_S))
    gateway, link, late = said["gateway"], said["link"], said["lateness"]
    expect(page.locator("#kind")).to_have_text("LOG")
    expect(page.locator("#title")).to_have_text("loss.log")
    expect(page.locator("#banner")).to_be_hidden()

    for row in said["drives"]:
        where = f".drive[data-node='{row['node']}']"
        lost = row["adhesion"] == "AdhesionLost"
        assert lost == (row["node"] == 2)
        assert flag(page, where, "adhesion") == f"{'✗' if lost else '✓'} {row['adhesion']}"
        assert flag(page, where, "thermal") == f"? thermal {row['thermal']}"
        assert flag(page, where, "health") == f"✓ {row['health']}"
        sigma = figure(row["load_sigma_nm"], 1)
        assert sigma != "?"
        assert value(page, where, "load") == f"{figure(row['load_nm'], 1)} ± {sigma} Nm"
        assert value(page, where, "loss") == f"{100 * row['loss_probability']:.0f} %"
        for key, field, digits, unit in (
            ("speed", "speed_rad_s", 1, "rad/s"), ("measured", "measured_speed_rad_s", 1, "rad/s"),
            ("stator", "stator_c", 1, "°C"), ("de", "drive_end_c", 1, "°C"),
            ("nde", "non_drive_end_c", 1, "°C"), ("ambient", "ambient_c", 1, "°C"),
            ("mixed", "mixed_c", 1, "°C"), ("maisd", "maisd_k", 2, "K"), ("nis", "nis", 1, ""),
            ("trend", "degradation_k_h", 3, "K/h"),
        ):  # fmt: skip
            assert value(page, where, key) == figure(row[field], digits, unit), (key, row["node"])
        assert value(page, where, "state") == row["state"]
        assert value(page, where, "heartbeat") == row["heartbeat"]
        assert value(page, where, "rejected") == str(row["rejected"])
        assert value(page, where, "fault") == row["fault_class"]
        assert value(page, where, "age") == f"{1000 * row['age_s']:.0f} ms"

    assert flag(page, "#gateway", "state") == f"✓ {gateway['state']}"
    assert flag(page, "#gateway", "common_mode") == "✓ common mode NotDetected"
    assert flag(page, "#gateway", "comm_fault") == "✓ communication NoFault"
    assert value(page, "#gateway", "reason").endswith(gateway["reason"])
    assert value(page, "#gateway", "thermal_reason").endswith(gateway["thermal_reason"])
    assert value(page, "#gateway", "age") == f"{gateway['age_ms']:.0f} ms"
    assert value(page, "#gateway", "detector") == gateway["detector"]
    assert value(page, "#gateway", "hash") == gateway["config_hash"]
    assert value(page, "#gateway", "misses") == str(gateway["deadline_misses"])
    assert flag(page, "#bus", "state") == f"✓ {link['state']}"
    assert value(page, "#bus", "load") == f"{link['bus_load_pct']:.1f} %"
    assert value(page, "#bus", "received") == str(link["received"])
    assert value(page, "#bus", "errors") == "0"

    rows = page.locator("#lateness tbody tr").all_inner_texts()
    assert [int(row.split("\t")[1]) for row in rows] == late["counts"]
    assert f"{late['total']} flags" in page.locator("#lateness").inner_text()
    lines = page.locator("#events li").all_inner_texts()
    assert len(lines) == len(said["events"])
    newest = said["events"][-1]
    assert newest["text"] in lines[0]
    assert any("drive 2: adhesion AdhesionLost" in line and "✗ error" in line for line in lines)


SOME = 10
"""Pixels of exactly a curve's colour that are a curve: most of a thin line is blended."""


READ = "willReadFrequently"
"""A hint of the browser at these tests' own reading of pixels."""


def see(page, k, colour, least=SOME):
    """Wait until so many pixels of a colour are in the k-th plot of drive 2."""
    until(lambda: page.wait_for_timeout(20) or drawn(page, k, colour) >= least)


def drawn(page, k, colour):
    """Pixels of a colour in the k-th plot of drive 2."""
    return page.evaluate(
        """([k, colour]) => {
          const canvas = document.querySelectorAll(".drive[data-node='2'] canvas")[k];
          const probe = document.createElement("canvas").getContext("2d");
          probe.fillStyle = colour; probe.fillRect(0, 0, 1, 1);
          const [r, g, b] = probe.getImageData(0, 0, 1, 1).data;
          const all = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
          let n = 0;
          for (let i = 0; i < all.length; i += 4)
            n += all[i] === r && all[i + 1] === g && all[i + 2] === b && all[i + 3] > 200;
          return n;
        }""",
        [k, colour],
    )


def test_the_plots_have_curves_and_the_loss_is_hatched(opened, address):
    page = opened(address, may_complain=READ)
    show(page, 1.0)
    page.locator(".drive[data-node='2']").scroll_into_view_if_needed()
    expect(page.locator(".drive[data-node='2'] canvas")).to_have_count(3)
    for k in range(3):
        see(page, k, "#0072b2")
    assert drawn(page, 2, "#d55e00") == 0
    show(page, LOST_S)
    see(page, 2, "#d55e00")
    labels = page.locator(".drive[data-node='2'] .plot").evaluate_all(
        "all => all.map((plot) => [plot.getAttribute('role'), plot.getAttribute('aria-label')])"
    )
    assert [role for role, _ in labels] == ["img"] * 3
    assert "Load torque of drive 2" in labels[1][1]


def test_plots_take_the_colours_of_a_scheme_that_changes(opened, address):
    page = opened(address, may_complain=READ)
    show(page, LOST_S)
    page.wait_for_selector(".drive[data-node='2'] canvas")
    see(page, 0, "#0072b2")
    page.emulate_media(color_scheme="dark")
    see(page, 0, "#56b4e9")
    assert drawn(page, 0, "#0072b2") == 0


def test_the_slider_by_keyboard(opened, address):
    page = opened(address)
    show(page, 1.0)
    slider = page.locator("#slider")
    slider.focus()
    for _ in range(5):
        page.keyboard.press("ArrowRight")
    expect(page.locator("#now")).to_have_text("1.5")
    expect(slider).to_have_attribute("aria-valuetext", "1.5 seconds of 3.0")
    page.keyboard.press("ArrowLeft")
    expect(page.locator("#now")).to_have_text("1.4")
    page.keyboard.press("End")
    expect(page.locator("#now")).to_have_text(f"{SECONDS:.1f}")
    page.keyboard.press("Home")
    expect(page.locator("#now")).to_have_text("0.0")
    expect(page.locator(".drive[data-node='2'] .flag[data-key=adhesion]")).to_have_text("? Unknown")


def test_play_pause_steps_and_speed_by_keyboard(opened, address):
    page = opened(address)
    show(page, 0.0)
    page.locator("#speed").select_option("0.25")
    page.locator("#play").focus()
    page.keyboard.press("Space")
    expect(page.locator("#play")).to_have_text("Pause")
    expect(page.locator("#now")).not_to_have_text("0.0")
    page.keyboard.press("Space")
    expect(page.locator("#play")).to_have_attribute("aria-pressed", "true")
    page.locator("body").click(position={"x": 5, "y": 5})
    show(page, 1.0)
    page.keyboard.press(".")
    expect(page.locator("#now")).to_have_text("2.0")
    page.keyboard.press(",")
    expect(page.locator("#now")).to_have_text("1.0")
    page.keyboard.press("Space")
    expect(page.locator("#play")).to_have_text("Pause")
    page.locator("[data-step='10']").click()
    expect(page.locator("#now")).to_have_text("3.0")
    page.locator("#play").click()  # at the end: again from the start
    expect(page.locator("#now")).not_to_have_text("3.0")
    page.locator("#speed").select_option("1")


def test_focus_goes_everywhere_and_is_seen(opened, address):
    page = opened(address)
    show(page, LOST_S)
    page.reload()  # from the top
    page.wait_for_selector(".drive .flag")
    seen = []
    for _ in range(10):
        page.keyboard.press("Tab")
        seen.append(
            page.evaluate(
                """() => {
                  const at = document.activeElement, style = getComputedStyle(at);
                  return [at.id || at.dataset?.step || at.tagName, style.outlineStyle,
                          parseFloat(style.outlineWidth)];
                }"""
            )
        )
        if seen[-1][0] == "OL":
            break
    assert [name for name, *_ in seen] == [
        "A", "play", "-10", "-1", "1", "10", "slider", "speed", "OL",
    ]  # fmt: skip
    for name, style, width in seen:
        assert style != "none", name
        assert width >= 2, name


def test_nothing_has_to_be_scrolled_sideways(opened, address):
    page = opened(address, size=PHONE)
    show(page, LOST_S)
    page.wait_for_selector("#events li")
    for width, height in (PHONE, (320, 568), (844, 390), (768, 1024), DESK):
        page.set_viewport_size({"width": width, "height": height})
        assert_nothing_is_too_wide(page)


def assert_nothing_is_too_wide(page):
    wide = page.evaluate(
        """() => [...document.querySelectorAll("body *")].filter((node) => node.checkVisibility()
            && !node.closest(".unseen, .skip")
            && node.getBoundingClientRect().right > innerWidth + 0.5
        ).map((n) => n.outerHTML.slice(0, 80))"""
    )
    assert wide == []
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
    cut = page.evaluate(
        """() => [...document.querySelectorAll(".flag, dt, dd, button, h2, h3")].filter((n) =>
            n.checkVisibility() && n.scrollWidth > n.clientWidth + 1 && n.clientWidth
        ).map((n) => n.outerHTML.slice(0, 80))"""
    )
    assert cut == []


def test_a_thumb_can_hit_what_is_to_be_hit(opened, address):
    page = opened(address, size=PHONE)
    for box in page.locator("#time button, #time select, #time input").all():
        size = box.bounding_box()
        assert size is not None
        assert size["height"] >= 32
        assert size["width"] >= 32


def test_every_text_can_be_read(opened, address):
    page = opened(address)
    for t_s in (0.0, LOST_S):
        show(page, t_s)
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            found = page.evaluate(CONTRAST)
            assert len(found) > 100
            assert [pair for pair in found if pair[1] < 4.5] == [], (t_s, scheme)


def test_the_measure_of_contrast_can_fail(opened, address):
    page = opened(address)
    page.evaluate("document.getElementById('title').style.color = '#999'")
    show(page, LOST_S)
    bad = [text for text, contrast in page.evaluate(CONTRAST) if contrast < 4.5]
    assert bad == ["loss.log"]


def test_nothing_is_told_by_colour_alone(opened, address):
    page = opened(address)
    show(page, LOST_S)
    texts = page.locator(".flag").all_inner_texts()
    assert len(texts) > 12
    for text in texts:
        sign, _, word = text.partition(" ")
        assert sign in SIGNS, text
        assert word, text
    for sign, kind in (("✓", "good"), ("✗", "bad"), ("?", "unknown")):
        for text in page.locator(f".flag.{kind}").all_inner_texts():
            assert text.startswith(sign), text


def test_without_the_monitor_nothing_is_good_any_more(opened, log):
    with monitor(log, "--web", "127.0.0.1:0") as where:
        page = opened(where, may_complain="ERR_CONNECTION|WebSocket|ERR_EMPTY")
        show(page, LOST_S)
        expect(page.locator(".flag.good").first).to_be_visible()
    expect(page.locator("#banner")).to_contain_text("no connection to the monitor")
    expect(page.locator("#banner")).to_have_attribute("role", "alert")
    expect(page.locator(".flag.good")).to_have_count(0)
    texts = page.locator(".drive .flag, #gateway .flag, #bus .flag").all_inner_texts()
    assert {text[0] for text in texts} == {"?"}
    assert value(page, ".drive[data-node='1']", "load") == "?"
    assert page.title().startswith("? ")
    assert [pair for pair in page.evaluate(CONTRAST) if pair[1] < 4.5] == []


def test_it_finds_the_monitor_again(opened):
    feed = Feed(FakeSource(live=True))
    with server_of(feed) as (_, port):
        page = opened(f"http://127.0.0.1:{port}/", may_complain="ERR_CONNECTION|WebSocket")
    expect(page.locator("#banner")).to_contain_text("no connection")
    with server_of(Feed(FakeSource(live=True)), port=port):
        expect(page.locator("#banner")).to_be_hidden()
        expect(page.locator(".drive[data-node='1'] .flag.good").first).to_be_visible()


def test_a_bus_without_a_gateway_is_told(opened, tmp_path):
    path = log_of(tmp_path / "drives.log", recorded().drives)
    with monitor(path, "--web", "127.0.0.1:0", "--at", "2") as where:
        page = opened(where)
        expect(page.locator("#banner")).to_contain_text("no gateway on this bus")
        expect(page.locator(".drive .flag.good")).to_have_count(0)
        expect(page.locator("#lateness")).to_contain_text("not known")
    with monitor(path, "--web", "127.0.0.1:0", "--at", "2", "--shadow") as where:
        page = opened(where, may_complain="ERR_CONNECTION|WebSocket")
        expect(page.locator("#banner")).to_contain_text("SHADOW")
        expect(page.locator(".drive[data-node='1'] .flag[data-key=health]")).to_have_text(
            "✓ Tracking"
        )


def test_a_bus_has_no_slider_and_a_picture_that_can_be_frozen(opened):
    source = FakeSource(live=True)
    with server_of(Feed(source)) as (_, port):
        page = opened(f"http://127.0.0.1:{port}/", may_complain="WebSocket|ERR_CONNECTION")
        expect(page.locator("#kind")).to_have_text("BUS")
        expect(page.locator("#slider")).to_be_hidden()
        page.locator("#play").click()
        expect(page.locator("#kind")).to_have_text("BUS, frozen")
        expect(page.locator("#banner")).to_contain_text("frozen")
        before = page.locator("#now").inner_text()
        page.wait_for_timeout(300)
        assert page.locator("#now").inner_text() == before
        assert not source.paused, "the bus is read on"
        page.locator("#play").click()
        expect(page.locator("#now")).not_to_have_text(before)


def test_what_comes_from_a_bus_stays_text(opened):
    evil = "<img src=x onerror=alert(1)><script>alert(2)</script>"

    def make(t_s):
        return snapshot(t_s, events=(Event(1.0, "error", 1, evil),))

    source = FakeSource(live=True, make=make)
    source.title = evil
    with server_of(Feed(source)) as (_, port):
        page = opened(f"http://127.0.0.1:{port}/", may_complain="WebSocket|ERR_CONNECTION")
        expect(page.locator("#title")).to_have_text(evil)
        expect(page.locator("#events li").first).to_contain_text(evil)
        assert page.locator("#events img, #title img, body script").count() == 0
        # A new error is also said to who does not see it.
        expect(page.locator("#said")).to_have_text(f"drive 1 {evil}")


def test_sixteen_drives_on_a_phone(opened):
    def make(t_s):
        shown = snapshot(t_s, points=600)
        rows = tuple(shown.drives[0]._replace(node=n) for n in range(1, 17))
        traces = tuple(shown.history[0]._replace(node=n) for n in range(1, 17))
        return shown._replace(drives=rows, history=traces)

    with server_of(Feed(FakeSource(live=True, make=make))) as (_, port):
        page = opened(f"http://127.0.0.1:{port}/", PHONE, may_complain="WebSocket|ERR_CONNECTION")
        expect(page.locator(".drive")).to_have_count(16)
        page.locator(".drive[data-node='16']").scroll_into_view_if_needed()
        page.wait_for_selector(".drive[data-node='16'] canvas")
        drawn_now = page.locator("canvas").count()
        assert drawn_now < 48, "what cannot be seen is not drawn"
        assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0


def test_a_token_comes_in_once_and_leaves_no_trace(opened, log, tmp_path):
    token = "s3cret-Token-of-32-characters-ab"
    path = tmp_path / "web.token"
    path.write_text(token)
    path.chmod(0o600)
    with monitor(log, "--web", "127.0.0.1:0", "--token-file", path) as where:
        # A page that is left or loaded anew asks no longer for what it had not got yet.
        left = "401|WebSocket|ERR_CONNECTION|ERR_ABORTED"
        page = opened(where, may_complain=left, ready="")
        expect(page.locator("body")).to_contain_text("a token is required")
        page.goto(f"{where}?token=wrong")
        expect(page.locator("body")).to_contain_text("wrong token")
        page.goto(f"{where}?token={token}")
        page.wait_for_selector(".drive .flag")
        assert page.url == where
        assert page.evaluate("document.cookie") == "", "scripts cannot read it"
        assert token not in page.content()
        cookies = page.context.cookies()
        assert [(c["httpOnly"], c["sameSite"]) for c in cookies] == [(True, "Strict")]
        page.reload()
        page.wait_for_selector(".drive .flag")
        asked = urllib.request.Request(
            f"{where}metrics", headers={"Authorization": f"Bearer {token}"}
        )
        with urllib.request.urlopen(asked) as answer:
            assert b"traction_gateway_drive_adhesion" in answer.read()


def test_a_page_of_others_gets_nothing(opened, browser, address, tmp_path):
    """A page from another origin in the same browser: no websocket, no reading."""
    feed = Feed(FakeSource(live=True))
    with server_of(feed) as (_, port):
        context = browser.new_context()
        page = context.new_page()
        page.goto(f"http://127.0.0.1:{port}/")  # another port is another origin
        got = page.evaluate(
            """async (where) => {
              const opened = await new Promise((done) => {
                const socket = new WebSocket(where.replace("http", "ws") + "look");
                socket.onopen = () => done("opened");
                socket.onerror = () => done("refused");
              });
              const read = await fetch(where + "metrics").then(() => "read", () => "refused");
              return [opened, read];
            }""",
            address,
        )
        context.close()
    assert got == ["refused", "refused"]


def test_json_of_numbers_is_never_nan():
    """What the page parses is JSON that every browser takes."""
    picture = Feed(FakeSource()).look()
    assert not re.search(r"NaN|Infinity", picture.message(None))
    assert json.loads(picture.message(None))

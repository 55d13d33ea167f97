"""The site builds without a warning, and no link of it leads nowhere."""

import logging
from html.parser import HTMLParser
from urllib.parse import unquote, urlsplit

import pytest
from mkdocs.commands.build import build
from mkdocs.config import load_config

import gateway.api
from gateway import cli
from gateway.settings.config import Config
from tests.docs.pages import ROOT

PACKAGES = ("dbc", "estimators", "gateway", "sim")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning"),
]


class Page(HTMLParser):
    """Anchors and references of one page."""

    def __init__(self, path):
        super().__init__()
        self.anchors = set()
        self.links = []
        self.text = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        for name, value in attrs:
            if name == "id" and value:
                self.anchors.add(value)
            if value and ((tag == "a" and name == "href") or name == "src"):
                self.links.append(value)

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    said = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: said.append(record.getMessage())
    logging.getLogger("mkdocs").addHandler(handler)
    try:
        build(load_config(str(ROOT / "mkdocs.yml"), site_dir=str(folder)))
    finally:
        logging.getLogger("mkdocs").removeHandler(handler)
    assert not said, "\n".join(said)
    return {path: Page(path) for path in folder.rglob("*.html")}, folder


def test_no_link_leads_nowhere(site):
    pages, _ = site
    broken = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc or path.name == "404.html":
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            if not target.exists():
                broken.append(f"{path.name}: {link}")
            elif target in pages and parts.fragment:
                anchors = pages[target].anchors
                if unquote(parts.fragment) not in anchors and parts.fragment != "__skip":
                    broken.append(f"{path.name}: {link}")
    assert len(pages) > 30
    assert not broken


def test_the_reference_names_every_verb_section_and_message(site):
    pages, folder = site

    def text(name):
        return "".join(pages[folder / "reference" / name].text)

    assert all(f"traction-gateway {verb}" in text("commands.html") for verb in cli.VERBS)
    keys = text("configuration.html")
    fields = Config.model_fields.items()
    sections = [name for name, field in fields if not field.exclude and name != "motor"]
    assert [name for name in sections if f"[{name}]" not in keys] == []
    assert "[motor.NAME]" in keys
    for name in ("messages.html", "messages_fd.html"):
        assert "Gateway_Adhesion" in text(name)
        assert "Drive{n}_Temperatures" in text(name)
    assert "Drive{n}_Samples" in text("messages_fd.html")
    assert "wet_one" in text("scenarios.html")


def test_the_reference_of_the_api_has_its_names_and_no_others(site):
    pages, folder = site
    page = pages[folder / "reference" / "api.html"]
    assert "Run the gateway over a recorded log" in "".join(page.text)
    names = {anchor for anchor in page.anchors if anchor.partition(".")[0] in PACKAGES}
    assert {
        "gateway.api.replay",
        "gateway.core.gateway.Gateway.step",
        "dbc.text.InputError",
    } <= names
    tops = {name for name in names if name.rpartition(".")[2][0].isupper() or name.count(".") < 3}
    assert {name.rpartition(".")[2] for name in tops} == set(gateway.api.__all__)

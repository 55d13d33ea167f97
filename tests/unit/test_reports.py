"""The report as a user gets it: what is in it is what was said, and it stands alone."""

import base64
import csv
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import pytest

from gateway.cli import main
from gateway.reports import ticks
from gateway.reports.page import SCRIPT
from gateway.reports.provenance import Program, program, sha256
from gateway.reports.run_report import FEW

GOLDEN = Path(__file__).parents[1] / "golden"
TWO = 'title = "a <b>loss</b> | 1"\nseed = 5\nduration_s = 1.5\ndrives = 2\n'
LOSS = '[[event]]\nat_s = 0.8\nfor_s = 0.3\ndrive = 2\nkind = "adhesion_loss"\ndepth = 0.7\n'
GOOD = '[[expect]]\nflag = "adhesion"\nis = "good"\ndrive = 1\nwithin_ms = 900\n'
NEVER = '[[expect]]\nflag = "adhesion"\nis = "good"\ndrive = 1\nnever = true\n'


class References(HTMLParser):
    """Everything that a page takes from somewhere, and its tags."""

    def __init__(self):
        super().__init__()
        self.found = []
        self.ids = []
        self.tags = set()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        for name, value in attrs:
            if name in ("src", "href", "data", "action", "srcset", "poster", "background"):
                self.found.append(value)
            if name == "id":
                self.ids.append(value)


def replayed(log, folder, *words):
    assert main(["replay", str(log), "--results", str(folder), *words]) == 0
    return folder


@pytest.fixture(scope="module")
def bad_bus(tmp_path_factory):
    """Of a log with rejected frames and losses."""
    return replayed(GOLDEN / "bad_bus.log.gz", tmp_path_factory.mktemp("reports") / "bad")


def cells(text, wanted):
    """Rows of the tables with this many columns."""
    rows = [line.strip("|").split("|") for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in row] for row in rows if len(row) == wanted]


def runs_of(path):
    """(drive, flag, state, from, to) of every interval in flags.csv, seconds from its first row."""
    said = {}
    with path.open() as file:
        rows = list(csv.DictReader(file))
    first, last = float(rows[0]["t_s"]), float(rows[-1]["t_s"])
    for row in rows:
        for flag in ("adhesion", "thermal"):
            mine = said.setdefault((row["drive"], flag), [])
            if not mine or mine[-1][1] != row[flag]:
                mine.append((float(row["t_s"]), row[flag]))
    found = set()
    for (drive, flag), changes in said.items():
        ends = [t for t, _ in changes[1:]] + [last]
        found |= {(drive, flag, state, f"{t - first:,.3f}", f"{end - first:,.3f}")
                  for (t, state), end in zip(changes, ends, strict=True)}  # fmt: skip
    return found


@pytest.mark.parametrize("case", ["bad_bus", "loss", "slow"])
def test_every_interval_of_flags_csv_is_in_the_table_and_the_reverse(case, tmp_path):
    folder = replayed(GOLDEN / f"{case}.log.gz", tmp_path)
    text = (folder / "report.md").read_text()
    table = text[text.index("intervals of the adhesion and thermal flags") :]
    table = table[: table.index("\n#")]
    rows = [row[:5] for row in cells(table, 7) if row[1] in ("adhesion", "thermal")]
    wanted = runs_of(folder / "flags.csv")
    assert len(rows) == len(wanted)
    assert set(map(tuple, rows)) == wanted
    assert f"All {len(wanted):,} intervals" in text
    assert ("<summary>All" in text) == (len(wanted) > FEW)
    for name in ("report.html", "report.md"):
        page = (folder / name).read_text()
        assert page.count("AdhesionLost</td>" if name.endswith("l") else " AdhesionLost |") >= sum(
            row[2] == "AdhesionLost" for row in wanted
        )


def test_counts_are_those_of_the_summary(bad_bus, capsys, tmp_path):
    main(["replay", str(GOLDEN / "bad_bus.log.gz")])
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("frames:")]
    wanted = dict(part.rsplit(" ", 1) for part in line.removeprefix("frames: ").split(", "))
    text = (bad_bus / "report.md").read_text()
    frames = text[text.index("Frames and bus") : text.index("How to read")]
    rows = cells(frames, 3)
    counted = {name: n.replace(",", "") for name, n, _ in rows if n.replace(",", "").isdigit()}
    assert counted == wanted
    assert {"error", "wrong_sequence"} <= set(wanted)
    assert "Not used, by cause" in frames


def test_the_page_stands_alone(bad_bus):
    page = (bad_bus / "report.html").read_text()
    assert page.count(SCRIPT) == 1
    page = page.replace(SCRIPT, "")
    seen = References()
    seen.feed(page)
    assert {"h1", "img", "details", "table"} <= seen.tags
    assert not {"script", "link", "iframe", "object", "base", "form"} & seen.tags
    pictures = [r for r in seen.found if r.startswith("data:image/svg+xml;base64,")]
    links = [r for r in seen.found if r.startswith("#")]
    assert len(pictures) == 4
    assert len(pictures) + len(links) == len(seen.found)
    assert {link[1:] for link in links} <= set(seen.ids)
    assert len(set(seen.ids)) == len(seen.ids)
    assert "url(" not in page
    assert "@import" not in page
    for picture in pictures:
        svg = base64.b64decode(picture.partition(",")[2]).decode()
        assert not re.findall(r"(?:href|src)=\"(?!#)", svg)
        assert "<script" not in svg
    for name in re.findall(r"\]\((.*?\.svg)\)", (bad_bus / "report.md").read_text()):
        assert (bad_bus / name).is_file()


def test_the_same_log_gives_the_same_bytes(bad_bus, tmp_path):
    """Also from another folder, and after other pictures were drawn."""
    log = tmp_path / "elsewhere" / "bad_bus.log.gz"
    log.parent.mkdir()
    shutil.copy(GOLDEN / log.name, log)
    again = replayed(log, tmp_path / "again")
    names = sorted(path.name for path in bad_bus.iterdir())
    assert names == sorted(path.name for path in again.iterdir())
    for name in names:
        assert (again / name).read_bytes() == (bad_bus / name).read_bytes(), name


def test_how_many_ticks_are_worked_on_together_changes_no_byte(bad_bus, tmp_path, monkeypatch):
    monkeypatch.setattr(ticks, "MOST_OF_LOG", 7)
    other = replayed(GOLDEN / "bad_bus.log.gz", tmp_path / "other")
    for path in bad_bus.iterdir():
        assert (other / path.name).read_bytes() == path.read_bytes(), path.name


def test_what_was_replayed_is_named(bad_bus):
    text = (bad_bus / "report.md").read_text()
    log = GOLDEN / "bad_bus.log.gz"
    assert f"`{sha256(log)}`" in text
    assert f"{log.stat().st_size:,} bytes" in text
    word = (bad_bus / "configuration.txt").read_text().split()[1]
    assert f"`{word}`" in text
    assert str(program()).split(" with")[0] in text
    assert "virtual clock" in text
    assert "Without ground truth" in text
    assert str(log.parent) not in text, "where it lay says nothing"


def test_truth_says_what_was_found(tmp_path, capsys, refused):
    scenario = tmp_path / "s.toml"
    scenario.write_text(TWO.replace("drives = 2", "drives = 3") + LOSS)
    log, truth = tmp_path / "s.log", tmp_path / "truth.csv"
    assert main(["sim", str(scenario), "-o", str(log), "--truth", str(truth)]) == 0
    folder = replayed(log, tmp_path / "r", "--truth", str(truth))
    text = (folder / "report.md").read_text()
    (row,) = [row for row in cells(text, 7) if row[:3] == ["2", "adhesion", "loss"]]
    said = csv.DictReader((folder / "flags.csv").read_text().splitlines())
    lost = [r for r in said if (r["drive"], r["adhesion"]) == ("2", "AdhesionLost")]
    told = [float(r["t_s"]) for r in lost]
    assert float(row[5]) == pytest.approx(1e3 * (told[0] - 0.8), abs=1.0)
    assert "1 of 1 event found" in text
    assert "0 false flags" in text
    lies = truth.read_text().replace(",1,1,0.0000", ",0,1,0.0000")
    truth.write_text(lies)
    text = (replayed(log, tmp_path / "r2", "--truth", str(truth)) / "report.md").read_text()
    assert "0 of 0 events found, 1 false flag." in text
    assert "**false**" in text
    truth.write_text("t_s\n1\n")
    words = ["replay", str(log), "--truth", str(truth)]
    capsys.readouterr()
    assert "first line" in refused(*words, "--results", tmp_path / "r3")
    assert "--results" in refused(*words)


def test_a_log_of_one_frame_has_a_report(tmp_path):
    log = tmp_path / "a <i>b<i>_c_|`$x_$\x1b.log"
    log.write_text("(1700000000.000000) <b>&|`_x_ 181#0000000000000000\n")
    text = (replayed(log, tmp_path / "r") / "report.md").read_text()
    page = (tmp_path / "r" / "report.html").read_text()
    seen = References()
    seen.feed(page)
    assert not {"i", "b"} & seen.tags
    assert "a &lt;i&gt;b&lt;i&gt;_c_|`$x_$\\x1b.log" in page
    assert "&lt;b&gt;&amp;|`_x_" in page
    assert "1 ticks" in text or "1 tick" in text
    assert "Adhesion was never known: there is no result. Thermal state was never known" in text


def test_hil_leaves_one_page_of_all_scenarios(tmp_path, capsys):
    (tmp_path / "a").mkdir()
    one, two = tmp_path / "one.toml", tmp_path / "a" / "one.toml"
    one.write_text(TWO + LOSS + GOOD)
    two.write_text(TWO + NEVER)
    out = tmp_path / "out"
    assert main(["hil", str(one), str(two), "--results", str(out)]) == 1
    assert f"report: {out / 'report.html'}" in capsys.readouterr().out
    text = (out / "report.md").read_text()
    assert "**FAILED: 1 of 2 scenarios, 1 of 2 expectations held.**" in text
    expected = cells(text, 5)
    (good,) = [row for row in expected if row[0] == "ok"]
    assert 0 < float(good[2]) <= float(good[3]) == 900
    (bad,) = [row for row in expected if row[0] == "**FAILED**"]
    assert "never" in bad[1]
    seen = References()
    seen.feed((out / "report.html").read_text())
    assert "b" not in seen.tags
    assert sum(r.startswith("data:image/svg") for r in seen.found) == 2 * 3
    assert len(set(seen.ids)) == len(seen.ids)
    assert {r[1:] for r in seen.found if r.startswith("#")} <= set(seen.ids)
    for name in ("one", "one-2"):
        assert (out / name / "drive2.svg").is_file()
        assert (out / name / "flags.csv").is_file()
    assert "| 2 | adhesion | loss | 0.800 | 1.100 |" in text
    assert main(["hil", str(one), "--results", str(tmp_path / "just")]) == 0
    assert "**Passed: 1 of 1 expectation held.**" in (tmp_path / "just/report.md").read_text()
    file = tmp_path / "file"
    file.write_text("")
    assert main(["hil", str(one), "--results", str(file)]) == 2


def test_a_program_says_where_it_comes_from():
    assert str(Program("1.2")) == "traction-gateway 1.2"
    assert str(Program("1.2", "0123456789abcdef", changed=True)) == (
        "traction-gateway 1.2, commit 0123456789ab with changes"
    )

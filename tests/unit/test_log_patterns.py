"""Text of programs that nobody knows: refused with a cure, proposed for, read by a pattern."""

from __future__ import annotations

from pathlib import Path

import pytest

from gateway.cli import main
from tests.unit.test_foreign_logs import lines_of

BYTES = "02 A0 03 04 05 06 07 F1"


def convert(path: Path, *options: str) -> int:
    return main(["convert", str(path), str(path.parent / "out.log"), "--frames", *options])


@pytest.mark.parametrize(
    "line",
    [f"0.0{{}} 181 8 {BYTES}", f"0.0{{}} 181 {BYTES}", "0.0{} 1 181 3 02 A0 03",
     f"{{}} 181 8 {BYTES}", f"0.0{{}} can0 181 {BYTES}", f"0.0{{}}\t181\t8\t{BYTES}",
     "0.0{} 181 02-A0-03", "10:00:00.0{} Rx 1 181 8 2 01 02"],
)  # fmt: skip
def test_text_that_no_reader_knows_is_refused_and_the_cure_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    path = tmp_path / "a.txt"
    path.write_text("".join(line.format(k) + "\n" for k in range(10, 22)))
    assert convert(path) == 2
    assert "`--line auto` proposes a pattern" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out.log").exists()


def test_an_empty_pattern_is_no_pattern(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.log"
    path.write_text("(1.000000) can0 181#01\n")
    assert convert(path, "--line", "") == 2
    assert "needs one time" in capsys.readouterr().err


@pytest.mark.parametrize("bus", ["", "2"])
def test_crtd_needs_its_types(tmp_path: Path, bus: str) -> None:
    path = tmp_path / "a.txt"
    path.write_text(f"1.0 {bus}R11 181 01\n1.1 {bus}T29 182 02\n1.2 {bus}R12 183 03\n")
    assert lines_of(path) == (["1 181#01", "1.1 00000182#02 T"], {"malformed": 1})

"""Records are laid out as the compiler lays them out, on x86-64 and on AArch64."""

import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from _traction_core import ffi

import core_build
from dbc import records

ROOT = Path(core_build.__file__).parent
RECORDS = {
    name: records.dtype_of(records.ffi.typeof(f"struct {name}"))
    for name in records.ffi.list_types()[1]
}
TARGETS = {
    "here": [], "x86_64": ["-target", "x86_64-linux-gnu.2.17"],
    "aarch64": ["-target", "aarch64-linux-gnu.2.17"],
}  # fmt: skip


def test_every_record_has_a_numpy_type():
    named = [name.removeprefix("struct ") for name in ffi.list_types()[1]]
    assert sorted(named) == sorted(RECORDS)


@pytest.mark.parametrize("target", TARGETS)
def test_offsets_and_sizes_are_the_compilers(target, tmp_path, request):
    """It refuses to compile a wrong one."""
    compiler = core_build.compiler()
    if TARGETS[target]:
        if find_spec("ziglang") is None:
            message = "needs ziglang: pip install -r requirements-compiler.lock"
            (pytest.fail if request.config.getoption("--require-ziglang") else pytest.skip)(message)
        compiler = [sys.executable, "-m", "ziglang", "cc", *TARGETS[target]]
    asserted = []
    for name, dtype in RECORDS.items():
        asserted.append(f"sizeof(struct {name}) == {dtype.itemsize}")
        for field, (kind, offset) in dtype.fields.items():
            asserted.append(f"offsetof(struct {name}, {field}) == {offset}")
            asserted.append(f"sizeof(((struct {name} *)0)->{field}) == {kind.itemsize}")
    text = ["#include <stddef.h>", '#include "gateway/core/records.h"', '#include "sim/records.h"']
    text += [f'_Static_assert({one}, "{one}");' for one in asserted]

    def compiled(lines):
        source = tmp_path / "offsets.c"
        source.write_text("\n".join(lines))
        command = [*compiler, "-std=c11", f"-I{ROOT}", "-c", str(source), "-o", f"{source}.o"]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    done = compiled(text)
    assert done.returncode == 0, done.stderr
    wrong = compiled([*text, '_Static_assert(sizeof(struct e2e_state) == 1, "made to fail");'])
    assert "made to fail" in wrong.stderr


def fields_of(header):
    """Record, field, 1 for a comment behind it: of every declaration in the text of a header."""
    text = re.sub(r"/\*.*?\*/", "#", header, flags=re.DOTALL)
    for record, body in re.findall(r"^struct (\w+) \{(.*?)^\};", text, re.MULTILINE | re.DOTALL):
        for code, comment in re.findall(r"([^;#]+);( *#)?", body):
            yield record, re.search(r"(\w+)\s*(\[[^]]*]\s*)*$", code)[1], bool(comment)


def test_every_field_has_a_comment():
    found = list(fields_of((ROOT / "gateway/core/records.h").read_text()))
    named = list(dict.fromkeys(record for record, _, _ in found))
    compiled = [(record, field) for record in named for field in RECORDS[record].names]
    assert len(named) > 100
    # A declaration of two fields, of which only the last is found, differs.
    assert [(record, field) for record, field, _ in found] == compiled
    assert [f"{record}.{field}" for record, field, comment in found if not comment] == []


def test_a_field_without_a_comment_is_found():
    lines = "/* of both */\n int a; /* A */\n double b[2];\n int c; int\n d[N]; /* D */\n"
    found = list(fields_of(f"struct one {{\n{lines}}};\n"))
    assert found == [("one", "a", 1), ("one", "b", 0), ("one", "c", 0), ("one", "d", 1)]


def test_the_core_does_not_include_the_simulator():
    """Nor the other way round: what is true cannot reach an estimate."""
    for source in (*core_build.SOURCES, *core_build.DEPENDS):
        own = source.split("/")[0]
        included = re.findall(r'^#include "(\w+)/', (ROOT / source).read_text(), re.MULTILINE)
        assert {one == "sim" for one in included} <= {own == "sim"}, source


def test_a_record_is_read_and_written_by_name():
    state = np.zeros(2, records.E2E_STATE)
    state[1]["window"] = range(5)
    pointer = ffi.from_buffer("struct e2e_state[]", state)
    assert list(pointer[1].window) == [0, 1, 2, 3, 4]
    pointer[0].counter = -7
    assert state["counter"].tolist() == [-7, 0]

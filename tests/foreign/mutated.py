"""Real logs, DBCs and configurations with accidents: cut, doubled, swapped, bits flipped, ...

    python -m tests.foreign.mutated --logs 500 --configurations 200

No traceback, an exit code of the contract, and counts that add up to the lines, in every one.
"""

import argparse
import contextlib
import gzip
import io
import random
import re
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Final

from dbc.candump.reader import Reader
from dbc.frames import block_of
from gateway import cli
from gateway.logfiles.convert import frame_sink

ROOT: Final = Path(__file__).parents[2]
LOGS: Final = sorted((ROOT / "tests" / "data" / "logs").glob("*.log"))
DBCS: Final = sorted((ROOT / "tests" / "data" / "dbc").glob("*.dbc"))
CONFIGURATIONS: Final = sorted((ROOT / "examples" / "inverters").glob("*.toml"))
KINDS: Final = (".log", ".asc", ".trc", ".csv", ".blf", ".mf4")
CODES: Final = (0, 1, 2)
_COUNTS: Final = re.compile(r"^(?:lines|objects|frames and records|rows): (.*)$", re.MULTILINE)
_GOOD: Final = ("ok", "fd", "remote", "error_frame")


def seeds(folder):
    """The real logs in every format."""
    out = []
    for number, log in enumerate(LOGS):
        frames = list(Reader(log))[:100]
        for kind in KINDS:
            path = folder / f"seed{number}{kind}"
            sink = frame_sink(path, kind)
            sink.add(block_of(frames))
            sink.close()
            out.append(path)
    return out


def mutated(data, rng, *, text):
    """One accident: its name, and the file after it."""
    kinds = ["cut", "doubled", "swapped", "bits", "hole", "zeros"]
    kind = rng.choice([*kinds, "re-encoded", "line ends", "word"] if text else kinds)
    at, size = rng.randrange(len(data) + 1), rng.randrange(1, 200)
    if kind == "cut":
        return kind, data[:at]
    if kind == "hole":
        return kind, data[:at] + data[at + size :]
    if kind == "zeros":
        return kind, data[:at] + bytes(size) + data[at:]
    if kind == "bits":
        out = bytearray(data)
        for _ in range(rng.randrange(1, 20)):
            out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
        return kind, bytes(out)
    if kind == "re-encoded":
        plain = data.decode("latin-1")
        return kind, plain.encode(rng.choice(["utf-16", "utf-8-sig", "utf-16-be", "utf-8"]))
    if kind == "line ends":
        return kind, data.replace(b"\r\n", b"\n").replace(
            b"\n", rng.choice([b"\r\n", b"\r", b"\n\n"])
        )
    lines = (
        data.splitlines(keepends=True)
        if text
        else [data[k : k + 48] for k in range(0, len(data), 48)]
    )
    if kind == "word":
        k = rng.randrange(len(lines))
        words = lines[k].split(b" ")
        words[rng.randrange(len(words))] = rng.choice(
            [b"", b"-1", b"XX", b"9" * 30, b"1e400", b"\xff"]
        )
        lines[k] = b" ".join(words)
        return kind, b"".join(lines)
    first, second = sorted(rng.randrange(len(lines)) for _ in range(2))
    if kind == "doubled":
        return kind, b"".join(lines[: second + 1] + lines[first:])
    lines[first], lines[second] = lines[second], lines[first]
    return kind, b"".join(lines)


def run(*words):
    """A verb: exit code, stdout, stderr. Raises what it should have caught."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = cli.main([str(word) for word in words])
    return code, out.getvalue(), err.getvalue()


def faults_of(code, said, told, out):
    """What is not as promised."""
    if code not in CODES:
        yield f"exit code {code}"
    if "Traceback" in told or "Traceback" in said:
        yield "a traceback"
    if code == 2 and not told.strip():
        yield "exit code 2 without a word"
    if (match := _COUNTS.search(said)) is None:
        if code != 2 and "is no" not in told:
            yield "no counts"
        return
    counts = {name: int(n) for name, n in re.findall(r"(\w+) (\d+)", match[1])}
    frames = sum(counts.get(name, 0) for name in _GOOD)
    read, written = (int(n) for n in re.findall(r"frames: read (\d+), written (\d+)", said)[0])
    left = re.search(r"^not written: (.*)$", said, re.MULTILINE)
    out_of = sum(int(n) for n in re.findall(r" (\d+)", left[1])) if left else 0
    if frames != read or read != written + out_of:
        yield f"{frames} frames counted, {read} read, {written} written, {out_of} left out"
    if code != 2 and sum(1 for _ in Reader(out)) != written:
        yield f"{out}: not the {written} frames that were counted"
    bad = sum(counts.get(name, 0) for name in ("malformed", "bad_length", "bad_id", "cut"))
    if bad > 0.01 * (bad + frames) and code == 0:
        yield f"exit code 0 with {bad} faults beside {frames} frames"


def one_log(seed, folder, number):
    """Convert one mutation to candump; its kind and what went wrong."""
    rng = random.Random(number)
    kind, data = mutated(seed.read_bytes(), rng, text=seed.suffix not in (".blf", ".mf4"))
    path = folder / f"m{number}{seed.suffix}"
    path.write_bytes(gzip.compress(data) if rng.random() < 0.1 else data)
    out = folder / "out.log"
    try:
        code, said, told = run("convert", path, out)
        wrong = list(faults_of(code, said, told, out))
        lines = data.count(b"\n")
        match = _COUNTS.search(said)
        if (
            match
            and seed.suffix == ".log"
            and kind not in ("re-encoded", "line ends", "bits", "zeros")
        ):
            counted = sum(int(n) for n in re.findall(r" (\d+)", match[1]))
            if counted != lines + (not data.endswith(b"\n") and bool(data)):
                wrong.append(f"{counted} of {lines} lines counted")
    except Exception as error:  # what nobody caught is the fault that is looked for
        wrong = [f"{type(error).__name__}: {error}"]
    path.unlink()
    out.unlink(missing_ok=True)
    return kind, [f"{number} {seed.name} {kind}: {text}" for text in wrong]


def one_configuration(number, folder):
    """A mutated configuration, or mapped DBC, through `check`; a DBC through `convert`."""
    rng = random.Random(number)
    source = rng.choice(CONFIGURATIONS)
    dbc = source.with_suffix(".dbc")
    names = {source.name: source.read_bytes(), dbc.name: dbc.read_bytes()}
    chosen = rng.choice(list(names))
    kind, names[chosen] = mutated(names[chosen], rng, text=True)
    for name, data in names.items():
        (folder / name).write_bytes(data)
    other = rng.choice(DBCS)
    _, data = mutated(other.read_bytes(), rng, text=True)
    (folder / "other.dbc").write_bytes(data)
    wrong = []
    for words in (
        ("check", folder / source.name, "--no-timing"),
        ("convert", LOGS[0], folder / "out.csv", "--dbc", folder / "other.dbc"),
    ):
        try:
            code, _, told = run(*words)
        except Exception as error:  # see above
            wrong.append(f"{words[0]}: {type(error).__name__}: {error}")
            continue
        if code not in CODES or "Traceback" in told or (code == 2 and not told.strip()):
            wrong.append(f"{words[0]}: exit code {code}: {told[-200:]}")
    return kind, [f"{number} {source.name} {kind}: {text}" for text in wrong]


def campaign(logs, configurations, first=0):
    """All of them: how many of each kind, and every fault."""
    kinds = Counter()
    wrong = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        originals = seeds(folder)
        for number in range(first, first + logs):
            kind, faults = one_log(originals[number % len(originals)], folder, number)
            kinds[f"log {kind}"] += 1
            wrong += faults
        for number in range(first, first + configurations):
            kind, faults = one_configuration(number, folder)
            kinds[f"configuration {kind}"] += 1
            wrong += faults
    return kinds, wrong


def main():
    """Print what was done; exit 1 if anything was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=500)
    parser.add_argument("--configurations", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    kinds, wrong = campaign(options.logs, options.configurations, options.first)
    print(", ".join(f"{kind} {n}" for kind, n in sorted(kinds.items())))
    print("\n".join(wrong) or "nothing wrong")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())

"""Fuzz target: the candump reader. Input: the text of a log, or a gzip file."""

import io
import random
from collections import Counter
from zlib import crc32

from dbc.candump import reader as module
from dbc.candump.grammar import Verdict, format_frame, parse_line
from dbc.candump.reader import LogError, Reader
from dbc.frame import Frame
from tests.fuzzing.held import Held
from tests.fuzzing.mutate import mutate
from tests.reference import candump as reference

ZIPPED = b"\x1f\x8b"
READERS = 128
"""One input of so many goes through the reader, strict and not; the others line by line."""
ZIPS = 8
"""The same of gzip files."""
WITH_FRAME = frozenset(v for v in Verdict if v <= Verdict.ERROR_FRAME)
ROUNDS = 4
"""In one input of so many every frame is written and read again."""
GROWN = 256
"""Lines that `readers` makes of those of its input."""
LONGEST_LINE = 160
Told = tuple[list[Frame], Counter[Verdict], int, list, int, str]


def candump(data, parse=parse_line, reader=Reader, every=READERS):
    """Every line has one verdict; the reader equals the reference. Returns the lines looked at."""
    if data.startswith(ZIPPED):
        return _zipped(data, reader, every)
    lines = data.split(b"\n")
    mark = crc32(data)
    read = [parse(line) for line in lines]
    for line, (verdict, frame) in zip(lines, read, strict=True):
        assert (verdict in WITH_FRAME) == (frame is not None), (line, verdict, frame)
        if frame is not None and not mark % ROUNDS:
            assert parse(format_frame(frame)) == (verdict, frame), line
    if mark % every:
        return len(lines)
    verdicts, frames = [verdict for verdict, _ in read], [f for _, f in read if f is not None]
    terminated = not lines[-1]
    told = [_read(reader, data, strict, mark) for strict in (False, True)]
    found, counts, count, problems, _, fault = told[0]
    assert count == counts.total() == len(lines) - terminated
    assert fault == ""
    assert found == frames or (not terminated and found == frames[:-1])
    assert len(found) == sum(counts[v] for v in WITH_FRAME)
    certain = Counter(verdicts[:-1])
    last = counts - certain
    assert certain <= counts, (counts, certain)
    assert terminated or set(last) <= {Verdict.CUT, verdicts[-1]}, last
    stopped, _, at, seen, _, fault = told[1]
    if problems:
        assert fault.startswith(f"log:{problems[0].line}: "), fault
        assert at == problems[0].line
        assert seen == problems[:1]
        assert stopped == found[: len(stopped)]
    else:
        assert told[1] == told[0]
    return len(lines)


def readers(data, tokens, reader=Reader):
    """Every input through the reader, as a log of hundreds of lines. Returns the lines read.

    Of a text most lines are mutations of its own; which, the text says, so that a case repeats.
    """
    if data.startswith(ZIPPED):
        return candump(data, reader=reader, every=1)
    rng, lines = random.Random(data), data.split(b"\n")
    grown = (mutate(rng.choice(lines), rng, tokens, lines, LONGEST_LINE) for _ in range(GROWN))
    return candump(b"\n".join((*grown, data)), reader=reader, every=1)


def _read(reader, data, strict, mark):
    """What is read, as the reference reads it; in small pieces: lines are cut everywhere."""
    usual, module._CHUNK = module._CHUNK, 8 + mark // READERS % 200
    try:
        log = reader(io.BytesIO(data), strict=strict)
        found = _told(log, iter(log))
    finally:
        module._CHUNK = usual
    assert found == tuple(reference.read(data, strict=strict))
    return found


def _told(reader, frames):
    found, fault, line = [], "", 0
    try:
        for frame in frames:
            found.append(frame)  # noqa: PERF402 - what came before a fault counts
    except LogError as error:
        fault, line = str(error), error.line
    assert not fault or (reader.strict and line == reader.lines)
    assert len(fault.splitlines()) <= 1, fault
    return found, +reader.counts, reader.lines, reader.problems, reader.drops, fault


def _zipped(data, reader, every):
    """Whatever can be unpacked is read, and strict reading says that it was damaged."""
    log = reader(Held(data))
    read = _told(log, iter(log))
    assert log.lines == log.counts.total()
    if crc32(data) % min(every, ZIPS):
        return log.lines
    strict = reader(Held(data), strict=True)
    stopped = _told(strict, iter(strict))
    assert bool(stopped[-1]) == bool(log.truncated or log.problems), (read, stopped)
    return log.lines

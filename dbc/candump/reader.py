"""Strict reader of candump logs (`candump -l`, `-L`).

Every line gets one verdict (see `dbc.candump.grammar`), and time is integer nanoseconds. No
content of a log raises an exception, except in strict mode: LogError with the line number.
"""

from __future__ import annotations

import re
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Final, NamedTuple

import numpy as np

from dbc.candump.blocks import LineKind, Lines, Scanner
from dbc.candump.grammar import (
    DROPS,
    MAX_LINE,
    Verdict,
    parse_line,
    tail_of,
)
from dbc.frame import Frame
from dbc.frames import Block, block_of
from dbc.prefetch import ahead
from dbc.text import InputError, printable, without_mark

PROBLEMS_KEPT: Final = 100
_CHUNK: Final = 1 << 20
_PIECE, _SMALL = 1 << 18, 1 << 12
"""Compressed bytes unpacked per call: many, as each call contends for the GIL; few in damage."""
_IDS_KEPT: Final = 100_000
_LINE_ENDS: Final = re.compile(rb"\n+")
_VERDICTS: Final = np.array(
    [Verdict.OK, Verdict.FD, Verdict.OK, Verdict.BLANK, Verdict.COMMENT, Verdict.MALFORMED],
    dtype=np.uint8,
)
"""Verdict of a line by its `LineKind`; lines of kind OTHER are parsed one by one."""
_TOO_LONG: Final = b"(a line of more than %d characters)" % MAX_LINE


class LogError(InputError):
    """A log that cannot be read, or not further; `line` counts from 1, 0 for logs without lines."""

    def __init__(self, source: str, line: int, why: str) -> None:
        """`why`: the reason in one line, without source and line number."""
        self.line = line
        super().__init__(f"{source}:{line}: {why}" if line else f"{source}: {why}")


class Problem(NamedTuple):
    """One faulty line."""

    line: int
    verdict: Verdict
    text: str


class LogReader:
    """Frames of a log, in file order: data, remote and error frames, distinguished by flags.

    After reading: `counts` (lines or objects per Verdict; their sum is `lines`), `problems` (the
    first 100 faults), `drops` (lost frames that candump reports), `truncated` (why the log ended
    early, else ""), `notes` (other remarks on the log). While reading, they cover everything up to
    the end of the last block. Memory does not grow with the file. Each iteration of a path starts
    anew.
    """

    unit = "lines"
    """Unit of `lines`."""

    def __init__(self, name: str, *, strict: bool) -> None:
        """name: name of the log in errors. Nothing is opened before iteration."""
        self.name, self.strict = name, strict
        self._reset()

    def _reset(self) -> None:
        self.counts: Counter[Verdict] = Counter()
        self.lines = self.drops = 0
        self.bytes_read = 0
        """Bytes read of the file as stored (compressed or not), for a progress bar."""
        self.problems: list[Problem] = []
        self.truncated = ""
        self.notes: list[str] = []

    def blocks(self) -> Iterator[Block]:
        """Read from the start. Raises LogError for another format; with `strict`, at a fault."""
        raise NotImplementedError

    def __iter__(self) -> Iterator[Frame]:
        """Read from the start, frame by frame."""
        for block in self.blocks():
            yield from block.frames()

    def _fault(self, problem: Problem) -> None:
        if len(self.problems) < PROBLEMS_KEPT:
            self.problems.append(problem)
        if self.strict:
            name = problem.verdict.name.lower().replace("_", " ")
            raise LogError(self.name, problem.line, f"{name}: {problem.text}")


class Reader(LogReader):
    """Reader of a path (gzip is recognised by its first bytes) or a binary stream, `source`.

    An unterminated last line may be the start of a longer one: a frame cut inside its data is
    a valid shorter frame. It is accepted only if the last frame of the same id had the same
    number of characters after the id; else its verdict is CUT. So a log of one frame without
    a line end yields no frame, and counts one CUT.

    Raises OSError if the file cannot be opened; with `strict`, LogError at the first fault.
    """

    def __init__(self, source: Path | str | IO[bytes], *, strict: bool = False) -> None:
        """Nothing is opened before iteration."""
        self._source = Path(source) if isinstance(source, str) else source
        name = str(self._source) if isinstance(self._source, Path) else "log"
        super().__init__(name, strict=strict)

    def blocks(self) -> Iterator[Block]:
        """Read from the start, in blocks: the same frames as by iteration, but faster."""
        self._reset()
        with ExitStack() as stack:
            yield from self._blocks(without_mark(self._chunks(stack)))

    def _blocks(self, chunks: Iterator[bytes]) -> Iterator[Block]:
        scanner = Scanner()
        tails: dict[bytes, int] = {}
        rest = b""
        skipping = False
        for chunk in chunks:
            piece = rest + chunk
            start = 0
            if skipping:
                start = piece.find(b"\n") + 1
                skipping = not start
                rest = b""
                if skipping:
                    continue
                self._judge(_TOO_LONG, tails)
            while True:
                if (run := _LINE_ENDS.match(piece, start)) is not None:
                    # Counted at once: gigabytes of line ends compress into a megabyte.
                    self.lines += run.end() - start
                    self.counts[Verdict.BLANK] += run.end() - start
                    start = run.end()
                if not (lines := scanner.read(piece, start)).rows.size:
                    break
                block, fault = self._accept(scanner, lines, piece, tails)
                if block.size:
                    yield block
                if fault is not None:
                    raise fault
                start = lines.end
            rest = piece[start:]
            if len(rest) > MAX_LINE:
                rest = b""
                skipping = True
        for k in np.flatnonzero(scanner.tails >= 0).tolist():
            tails[b"%03X" % k] = tails[b"%03x" % k] = int(scanner.tails[k])
        frame = self._last(_TOO_LONG if skipping else rest, tails)
        if frame is not None:
            yield block_of([frame])

    def _accept(
        self, scanner: Scanner, lines: Lines, text: bytes, tails: dict[bytes, int]
    ) -> tuple[Block, LogError | None]:
        """Parse the lines that are not plain; return all frames, or those before a fault and it."""
        kind = lines.kind
        kept = kind <= LineKind.FD
        by_hand = kind == LineKind.OTHER
        if self.strict or len(self.problems) < PROBLEMS_KEPT:
            by_hand |= kind == LineKind.MALFORMED
        fault = None
        done, last = 0, kind.size
        for k in np.flatnonzero(by_hand).tolist():
            self.lines += k - done
            done = k + 1
            line = lines.line(text, k)
            try:
                frame = self._judge(line, tails)
            except LogError as raised:
                fault = raised
                kept[k:] = False
                done = last = k
                break
            if frame is not None:
                kept[k] = True
                scanner.put(lines, k, frame, line)
        self.lines += last - done
        counts = np.bincount(_VERDICTS[kind[:last][~by_hand[:last]]])
        self.counts.update({Verdict(v): n for v, n in enumerate(counts.tolist()) if n})
        return scanner.finish(lines, kept), fault

    def _chunks(self, stack: ExitStack) -> Iterator[bytes]:
        stream = self._source
        if isinstance(stream, Path):
            stream = stack.enter_context(stream.open("rb"))
        chunk = stream.read(_CHUNK)
        self.bytes_read += len(chunk)
        if isinstance(self._source, Path) and chunk[:2] == b"\x1f\x8b":
            yield from ahead(self._unzipped(chunk, stream))
            return
        while chunk:
            yield chunk
            chunk = stream.read(_CHUNK)
            self.bytes_read += len(chunk)

    def _unzipped(self, chunk: bytes, stream: IO[bytes]) -> Iterator[bytes]:
        """Yield the members of a gzip file; of a truncated one, all that can be unpacked.

        zlib is used directly, because gzip.GzipFile discards what it has unpacked when it reaches
        the cut. zlib loses a damaged piece whole, so it is unpacked again in small pieces.
        """
        unpack = zlib.decompressobj(wbits=31)
        pending = memoryview(chunk)
        most = _PIECE
        done: list[bytes] = []
        size = 0
        try:
            while pending:
                before = unpack.copy() if most > _SMALL else unpack
                try:
                    text = unpack.decompress(pending[:most], _CHUNK)
                except zlib.error:
                    if most == _SMALL:
                        raise
                    unpack, most = before, _SMALL
                    continue
                done.append(text)
                size += len(text)
                if size >= _CHUNK:
                    yield b"".join(done)
                    done, size = [], 0
                pending = pending[most:]
                if unpack.unconsumed_tail:
                    pending = memoryview(unpack.unconsumed_tail + pending)
                if unpack.eof:
                    left = (unpack.unused_data + pending).lstrip(b"\0")
                    pending = memoryview(left or stream.read(_CHUNK).lstrip(b"\0"))
                    if pending:
                        unpack = zlib.decompressobj(wbits=31)
                elif not pending:
                    pending = memoryview(stream.read(_CHUNK))
                    self.bytes_read += len(pending)
            done.append(unpack.flush())
            if not unpack.eof:
                self.truncated = "compressed data end early"
        except zlib.error as error:
            self.truncated = f"compressed data are damaged ({error})"
        yield b"".join(done)

    def _last(self, rest: bytes, tails: dict[bytes, int]) -> Frame | None:
        """The frame of the text behind the last line end, if it is accepted."""
        if rest:
            return self._judge(rest, tails, last=True)
        if self.truncated:
            self._fault(Problem(self.lines, Verdict.CUT, self.truncated))
        return None

    def _judge(self, line: bytes, tails: dict[bytes, int], *, last: bool = False) -> Frame | None:
        """Parse one line, count its verdict, and return its frame."""
        verdict, frame = parse_line(line)
        if last and self.truncated:
            # Whatever the line looks like, data are missing, and strict reading must report it.
            verdict, frame = Verdict.CUT, None
        elif last and verdict not in (Verdict.BLANK, Verdict.COMMENT, Verdict.DROPCOUNT):
            verdict, frame = _unterminated(line, verdict, frame, tails)
        self.lines += 1
        self.counts[verdict] += 1
        if frame is not None:
            digits, tail = tail_of(line)
            if len(tails) > _IDS_KEPT:
                tails.clear()
            tails[digits] = tail
        elif verdict is Verdict.DROPCOUNT and (match := DROPS.match(line)):
            self.drops += int(match[1])
        elif verdict.is_fault:
            text = printable(line[:120].decode("ascii", "backslashreplace").strip())
            text = f"{self.truncated}: {text}" if last and self.truncated else text
            self._fault(Problem(self.lines, verdict, text))
        return frame


def _unterminated(
    line: bytes, verdict: Verdict, frame: Frame | None, tails: dict[bytes, int]
) -> tuple[Verdict, Frame | None]:
    """Accept an unterminated last line only if the last one of its id was as long, else CUT."""
    if frame is not None:
        digits, tail = tail_of(line)
        if tails.get(digits) == tail:
            return verdict, frame
    return Verdict.CUT, None

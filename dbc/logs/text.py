"""Reader of text logs of any format: counts, truncated files and blocks, as for candump logs.

A format is a `Format`: a regular expression for its plain lines, many of which are read at once,
and a function for any other line. The text between the time and the data of a frame (its head)
often recurs, so it is parsed once and kept.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.candump.grammar import MAX_LINE, Verdict
from dbc.candump.reader import PROBLEMS_KEPT, LogError, Problem, Reader
from dbc.frame import EXTENDED, FD, REMOTE, SECOND
from dbc.frames import MAX_DATA_BYTES, Block
from dbc.logs.format import CLASSIC_BYTES, Format, Head, Line, checked, verdict_with, words_of
from dbc.logs.lines import Scan, Scanner
from dbc.logs.pattern import Pattern
from dbc.text import printable, without_colours

_RUN: Final = 16
"""Mean length in lines of runs of plain or other lines, below which lines are read one by one."""
_HEADS_KEPT: Final = 100_000
_BLANK: Final = re.compile(r"\n{3,}")


class TextReader(Reader):
    """Frames of a text log, with the counts, problems and rules for truncated files of `Reader`.

    An unterminated last line is accepted if it has the length that it states, with the last digit
    of its last byte. If lines state no length, it must be as long as the last line of the same
    identifier. Otherwise its verdict is CUT.
    """

    def __init__(
        self, source: Path | str, make: Callable[[], Format], *, strict: bool = False
    ) -> None:
        """`make` returns the format in its state at the start of a log."""
        super().__init__(source, strict=strict)
        self._make = make

    def _blocks(self, chunks: Iterator[bytes]) -> Iterator[Block]:
        self._format = self._make()
        self._format.notes = self.notes
        self._recent: list[tuple[str, ...]] = []
        self._text = ""
        self._headers: list[tuple[int, str]] = []
        self._shift_ns: int | None = None
        self._scanner = Scanner(self._known)
        self._heads: dict[tuple[str, ...], Head] = {}
        for text, last in self._texts(chunks):
            at = 0
            for run in _BLANK.finditer(text):
                yield from self._piece(text[at : run.start() + 1])
                blank = run.end() - run.start() - 1
                self.lines += blank
                self.counts[Verdict.BLANK] += blank
                at = run.end()
            yield from self._piece(text[at:]) if not last else self._last_line(text[at:])
        if self.truncated and not self.counts[Verdict.CUT]:
            self.counts[Verdict.CUT] += 1
            self._fault(Problem(self.lines, Verdict.CUT, self.truncated))

    def _texts(self, chunks: Iterable[bytes]) -> Iterator[tuple[str, bool]]:
        """Yield (whole lines, False), at the end (text behind the last line feed, True)."""
        rest = ""
        skipping = old = False
        for k, chunk in enumerate(chunks):
            text = rest + chunk.decode("latin-1")
            old = old or (not k and "\n" not in text and "\r" in text)
            if old:  # line ends of old Macintosh systems
                text = text.replace("\r", "\n")
            if skipping:
                start = text.find("\n") + 1
                rest = ""
                if not start:
                    continue
                skipping = False
                text = text[start:]
                self._one(f"(a line of more than {MAX_LINE} characters)", Verdict.MALFORMED)
            end = text.rfind("\n") + 1
            rest = text[end:]
            if end:
                yield without_colours(text[:end]).replace("\r", ""), False
            if len(rest) > MAX_LINE:
                rest, skipping = "", True
        if skipping:
            self._one(f"(a line of more than {MAX_LINE} characters)", Verdict.CUT)
        elif rest:
            yield without_colours(rest).replace("\r", ""), True

    def _last_line(self, text: str) -> Iterator[Block]:
        form = self._format
        row = self._matches(text)[0]
        # The identifier of a name is at the end of a line.
        plain = row[0] and not form.has_names
        line = self._plain(row) if plain else self._other(text)
        # The start of a frame may look like an event.
        known = not line.verdict.is_fault and line.verdict is not Verdict.EVENT
        if line.head is None and known:
            self._one(text, line.verdict)
        elif self.truncated or line.verdict.is_fault or not line.sure or line.t_ns is None:
            self._one(f"{self.truncated}: {text}" if self.truncated else text, Verdict.CUT)
        elif line.verdict > Verdict.ERROR_FRAME:
            self._one(text, line.verdict)
        else:
            self.lines += 1
            self.counts[line.verdict] += 1
            times = form.clock(np.array([line.t_ns]), np.array([True]))
            yield self._block(times, [line.head or Head(0)], [line.data])

    def _plain(self, row: tuple[str, ...]) -> Line:
        """Parse one plain line; `sure` if its stated length shows that it is complete."""
        head = self._head(row[1:-2])
        try:
            t_ns = self._format.times([row[0]]).item()
            data = self._format.data(row[-2], head.length)
        except (ValueError, OverflowError):
            return Line(Verdict.MALFORMED)
        sure = head.length == len(data) and (not data or self._format.whole(row[-2]))
        if head.length < 0:
            same = (r for r in reversed(self._recent) if r[0] and self._alike(r, head))
            sure = len(next(same, ("", ""))[-2]) == len(row[-2]) > 0
        return Line(verdict_with(head, data), head, t_ns, data, sure)

    def _alike(self, row: tuple[str, ...], head: Head) -> bool:
        """Whether a plain line has the identifier and length of this head."""
        other = self._head(row[1:-2])
        same = other.can_id == head.can_id and other.length == head.length
        return same and not (other.flags ^ head.flags) & EXTENDED

    def _piece(self, text: str) -> Iterator[Block]:
        """Read whole lines: runs of plain ones at once, if the format allows it."""
        data = text.encode("latin-1") if self._format.shape is not None else b""
        at = 0
        while at < len(data) and (shape := self._format.shape) is not None:
            scan = self._scanner.scan(data, at, shape)
            edges = np.flatnonzero(np.diff(scan.plain, prepend=False, append=False)).tolist()
            if len(edges) > len(scan.plain) // _RUN:
                break
            done = 0
            for first, last in zip(edges[::2], edges[1::2], strict=True):
                yield from self._lines_of(text, scan, done, first)
                if self._format.shape is not shape:
                    break
                yield self._run(scan.rows.part(first, last))
                done = last
            else:
                yield from self._lines_of(text, scan, done, len(scan.plain))
                first = len(scan.plain)
            at = scan.start.item(first)
        yield from self._by_lines(text[at:])

    def _lines_of(self, text: str, scan: Scan, first: int, last: int) -> Iterator[Block]:
        return self._by_lines(text[scan.start.item(first) : scan.start.item(last)])

    def _run(self, rows: Block) -> Block:
        """The block of a run of plain lines, which are counted."""
        self._format.began = True
        fd = int(np.count_nonzero(rows.flags & FD))
        self.lines += rows.size
        for verdict, count in ((Verdict.OK, rows.size - fd), (Verdict.FD, fd)):
            if count:
                self.counts[verdict] += count
        times = self._format.clock(rows.t_ns, np.ones(rows.size, dtype=np.bool_))
        return rows._replace(t_ns=self._moved(times))

    def _known(self, text: str, line: str) -> Head | None:
        """A head of plain data frames; None for any other head."""
        parts = tuple(words_of(text)) if self._format.splits else (text,)
        self._format.learn(line)
        head = checked(self._format.head(parts))
        return head if head.verdict in (Verdict.OK, Verdict.FD) and head.length >= 0 else None

    def _by_lines(self, text: str) -> Iterator[Block]:
        """Read whole lines with the regular expression; again behind a line that changes it."""
        while text:
            rows = self._recent = self._matches(text[:-1])
            self._text = text
            self._format.learn(text)
            lines, taken = self._others(rows)
            block, fault = self._rows(rows[:taken], lines)
            if block is not None:
                yield block
            if fault is not None:
                raise fault
            if taken == len(rows):
                return
            at = 0
            for _ in range(taken):
                at = text.index("\n", at) + 1
            text = text[at:]

    def _matches(self, text: str) -> list[tuple[str, ...]]:
        rows: list[tuple[str, ...]] = self._format.regex.findall(text)
        if self._format.order:
            rows = list(map(itemgetter(*self._format.order), rows))
        return rows

    def _others(self, rows: list[tuple[str, ...]]) -> tuple[dict[int, Line], int]:
        """Lines that are not plain, and the number of rows before a change of the format."""
        lines: dict[int, Line] = {}
        form = self._format
        began = form.began
        for k, row in enumerate(rows):
            if row[0]:
                began = True
                continue
            form.began = began
            changes = form.changes(row[-1])
            if changes and k:
                return lines, k
            lines[k] = self._other(row[-1])
            if changes:
                # The meaning of heads depends on the format.
                self._heads.clear()
                self._scanner = Scanner(self._known)
                return lines, 1
        form.began = began
        return lines, len(rows)

    def _other(self, text: str) -> Line:
        """Parse a line that is not plain."""
        return self._format.line(text) if text.strip() else Line(Verdict.BLANK)

    def _rows(
        self, rows: list[tuple[str, ...]], lines: dict[int, Line]
    ) -> tuple[Block | None, LogError | None]:
        """Frames of rows, `lines` being parsed already; with a fault, those before it, and it."""
        texts = {k: rows[k][-1] for k in lines}
        times, timed = self._times(rows, lines)
        heads, bodies = [Head(0)] * len(rows), [b""] * len(rows)
        known, data_of = self._heads, self._format.data
        for k, row in enumerate(rows):
            if k in lines:
                continue
            parts = row[1:-2]
            head = known.get(parts) or self._head(parts)
            try:
                data = data_of(row[-2], head.length)
            except ValueError:
                lines[k] = Line(Verdict.MALFORMED)
                continue
            size = len(data)
            same = size == head.length or (head.length < 0 and size <= CLASSIC_BYTES)
            if not same and head.flags & REMOTE:  # some recorders write bytes, all of them zero
                data, same = b"", True
            if same and not head.verdict:
                heads[k], bodies[k] = head, data
            else:
                lines[k] = Line(verdict_with(head, data), head, 0, data)
        times = self._format.clock(times, timed)
        kept = np.ones(len(rows), dtype=np.bool_)
        last, fault = len(rows), None
        for k in sorted(lines):
            line = lines[k]
            self.counts[line.verdict] += 1
            kept[k] = line.verdict <= Verdict.ERROR_FRAME
            if line.head is not None and kept[k]:
                heads[k], bodies[k] = line.head, line.data
            elif line.verdict is Verdict.HEADER:
                self._keep_header(self.lines + k + 1, texts[k])
            elif line.verdict.is_fault:
                text = texts.get(k) or self._line_of(rows[k], k)
                try:
                    self._report(self.lines + k + 1, line.verdict, text)
                except LogError as raised:
                    kept[k:], last, fault = False, k, raised
                    break
        if plain := last - sum(k < last for k in lines):
            self.counts[Verdict.OK] += plain
        self.lines += last + (fault is not None)
        frames = np.flatnonzero(kept).tolist()
        if not frames:
            return None, fault
        if len(frames) != len(rows):
            heads, bodies = [heads[k] for k in frames], [bodies[k] for k in frames]
        return self._block(times[kept], heads, bodies), fault

    def _line_of(self, row: tuple[str, ...], k: int) -> str:
        """Line k of the text, for a message; only its groups if no message will show it."""
        shown = self.strict or len(self.problems) < PROBLEMS_KEPT
        return self._text.split("\n", k + 1)[k] if shown else " ".join(row[:-1])

    def _times(
        self, rows: list[tuple[str, ...]], lines: dict[int, Line]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Times of all lines, and which have one. A plain line with a bad time is malformed."""
        plain = [k for k in range(len(rows)) if k not in lines]
        times, timed = np.zeros(len(rows), dtype=np.int64), np.zeros(len(rows), dtype=np.bool_)
        try:
            times[plain] = self._format.times([rows[k][0] for k in plain])
        except (ValueError, OverflowError):
            for k in plain:
                try:
                    times[k] = self._format.times([rows[k][0]]).item()
                except (ValueError, OverflowError):
                    lines[k] = Line(Verdict.MALFORMED)
        timed[plain] = True
        for k, line in lines.items():
            timed[k] = line.t_ns is not None
            times[k] = line.t_ns or 0
        return times, timed

    def _one(self, text: str, verdict: Verdict) -> None:
        """Count a line without a frame."""
        self.lines += 1
        self.counts[verdict] += 1
        if verdict is Verdict.HEADER:
            self._keep_header(self.lines, text)
        if verdict.is_fault:
            self._report(self.lines, verdict, text)

    def nearest_header(self) -> Problem | None:
        """The line among those counted as header that is most like a frame.

        None if the format cannot compare lines, or there is no header.
        """
        form = self._format
        if not isinstance(form, Pattern) or not self._headers:
            return None
        number, text = max(self._headers, key=lambda header: form.matched_columns(header[1]))
        return Problem(number, Verdict.HEADER, self._explained(text))

    def _keep_header(self, line: int, text: str) -> None:
        if len(self._headers) < PROBLEMS_KEPT:
            self._headers.append((line, text[:MAX_LINE].rstrip()))

    def _report(self, line: int, verdict: Verdict, text: str) -> None:
        malformed = verdict is Verdict.MALFORMED
        shown = self._explained(text) if malformed else printable(text[:MAX_LINE].strip()[:120])
        self._fault(Problem(line, verdict, shown))

    def _explained(self, text: str) -> str:
        """A line, preceded by its fault if the format can name that."""
        text = text[:MAX_LINE].rstrip()
        reason = self._format.explain(text)
        text = text.lstrip()[:120]
        return printable(f"{reason}: {text[:60]}" if reason else text)

    def _head(self, parts: tuple[str, ...]) -> Head:
        if len(self._heads) > _HEADS_KEPT:
            self._heads.clear()
        head = self._heads[parts] = checked(self._format.head(parts))
        return head

    def _moved(self, times: NDArray[np.int64]) -> NDArray[np.int64]:
        """Shift the times forward if the log begins before 0."""
        if self._shift_ns is None:
            # A log may begin before its trigger, but candump's text, for example, has no sign.
            seconds = max(-(times.min().item() // SECOND), 0)
            self._shift_ns = seconds * SECOND
            if seconds:
                self.notes.append(f"times begin before 0: all are moved forward by {seconds} s")
        return times + self._shift_ns if self._shift_ns else times

    def _block(
        self, times: NDArray[np.int64], heads: Sequence[Head], bodies: Sequence[bytes]
    ) -> Block:
        # There are few different heads, and comparing them by identity is enough.
        number = {id(head): head for head in heads}
        place = {key: k for k, key in enumerate(number)}
        which = np.array([place[id(head)] for head in heads], dtype=np.intp)
        can_id, flags, _, channel, dlc, _ = zip(*number.values(), strict=True)
        names = list(dict.fromkeys(channel))
        joined = bytearray().join([item.ljust(MAX_DATA_BYTES, b"\0") for item in bodies])
        return Block(
            self._moved(times),
            np.array(can_id, dtype=np.uint32)[which],
            np.array(flags, dtype=np.uint8)[which],
            np.array(list(map(len, bodies)), dtype=np.uint8),
            np.frombuffer(joined, dtype=np.uint8).reshape(-1, MAX_DATA_BYTES),
            np.array(dlc, dtype=np.int8)[which],
            np.array([names.index(name) for name in channel], dtype=np.uint16)[which],
            names,
        )

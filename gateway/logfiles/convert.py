"""Converts one file to another; the endings of their names decide the formats."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from dbc.candump.reader import LogError
from dbc.codec import Codec
from dbc.frame import MS
from dbc.frames import Block
from gateway.io import extras
from gateway.io.log_file import NO_FRAME, BadLogError, Log, OneChannel, open_log
from gateway.io.logtime import LogTime
from gateway.io.whole_file import whole
from gateway.logfiles import frames as frame_files
from gateway.logfiles.frames import Sink
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from gateway.logfiles.signals import Decoder

FRAMES: Final = (".log", ".log.gz", ".asc", ".blf", ".trc")
"""Endings of files that hold only frames."""
SIGNALS: Final = (".parquet", ".mf4", ".mcap", ".csv", ".csv.gz")
"""Endings of files that hold decoded signals, or frames on request."""
ASCENDING: Final = (".asc", ".blf", ".trc", ".mf4", ".mcap")
"""Endings of formats in which time only goes forward."""
TIME_FAULTS: Final = ("time_back", "before_the_first", "before_1970")
"""Causes for not writing a frame that are faults of the log's time."""
_EXTRA: Final = {
    ".parquet": ("pyarrow", "parquet"),
    ".mf4": ("asammdf", "mf4"),
    ".mcap": ("mcap", "mcap"),
}


class Done(NamedTuple):
    """Result of a conversion.

    read: number of frames; cut: why reading ended early, else empty; steps: number of times that
    the log's clock was set back, after each of which all later times are moved forward.
    """

    read: int
    sink: Sink
    cut: str
    steps: int

    @property
    def time_faults(self) -> dict[str, int]:
        """Frames that were not written because of their time, by cause."""
        return {cause: self.sink.left_out[cause] for cause in TIME_FAULTS}


def ending(path: Path) -> str:
    """Suffix of a file's name, in lower case, with any `.gz` after it."""
    name = path.name.lower()
    plain = name.removesuffix(".gz")
    return Path(plain).suffix + name[len(plain) :]


def out_ending(path: Path, frames: bool) -> str:
    """Ending of a file to be written. Raises ConfigError if it cannot be written."""
    kind = ending(path)
    if kind not in FRAMES + SIGNALS:
        raise ConfigError(
            f"{path}: cannot write a file with the ending {kind or '(none)'!r}",
            [f"frames: {' '.join(FRAMES)}", f"signals: {' '.join(SIGNALS)}"],
        )
    if frames and kind == ".csv.gz":
        raise ConfigError(f"{path}: no frames in .csv.gz", ["name it .csv, or leave --frames out"])
    if path.is_dir():
        raise ConfigError(f"{path}: is a folder", ["name a file"])
    need(path)
    return kind


def need(path: Path) -> None:
    """Raises ConfigError, which says what to install, if the ending needs a missing library."""
    module, extra = _EXTRA.get(ending(path).removesuffix(".gz"), ("", ""))
    if module:
        extras.need((module,), extra, str(path))


def open_input(path: Path, strict: bool, line: str = "") -> Log:
    """Open a log with `open_log`, or Parquet of frames. Raises ConfigError, BadLogError."""
    need(path)
    if ending(path) == ".parquet" and path.is_file():
        reader = frame_files.ParquetReader(path, strict=strict)
        return Log(reader.blocks(), reader)
    return open_log(path, strict, line)


def of_channel(blocks: Iterable[Block], wanted: str | None) -> Iterator[Block]:
    """The frames of one channel; None: of all. Raises BadLogError if there is no such channel."""
    return iter(blocks) if wanted is None else iter(OneChannel(blocks, wanted))


def frame_sink(path: Path, kind: str) -> Sink:
    """The writer of frames for an ending from `out_ending`."""
    if kind in (".log", ".log.gz"):
        return frame_files.Candump(path)
    if kind == ".parquet":
        return frame_files.ParquetFrames(path)
    if kind == ".mf4":
        from gateway.logfiles.mf4 import Mf4Frames

        return Mf4Frames(path)
    if kind == ".mcap":
        from gateway.logfiles.mcap import McapFile

        return McapFile(path)
    if kind == ".blf":
        from gateway.logfiles.blf import BlfFile

        return BlfFile(path)
    from gateway.logfiles import text as text_files

    kinds = {".asc": text_files.AscFile, ".trc": text_files.TrcFile, ".csv": text_files.CsvFrames}
    return kinds[kind](path)


def signal_sink(path: Path, kind: str, decoder: Decoder, blocks: Iterable[Block]) -> Sink:
    """The writer of signals for an ending from `out_ending`. blocks: read here for the columns."""
    if kind == ".mf4":
        from gateway.logfiles.mf4 import Mf4Signals

        return Mf4Signals(path, decoder, comments_of(decoder.codec))
    if kind == ".mcap":
        from gateway.logfiles.mcap import McapFile

        return McapFile(path, decoder, comments_of(decoder.codec))
    from gateway.logfiles.signal_files import CsvSignals, ParquetSignals
    from gateway.logfiles.signals import seen

    messages = seen(_readable(blocks), decoder.codec)
    if kind == ".parquet":
        return ParquetSignals(path, decoder, messages, comments_of(decoder.codec))
    return CsvSignals(path, decoder, messages)


def _readable(blocks: Iterable[Block]) -> Iterator[Block]:
    """The readable blocks; the conversion meets and reports the same fault later."""
    try:
        yield from blocks
    except LogError:
        return


def comments_of(codec: Codec) -> dict[str, str]:
    """`Message` and `Message.Signal` -> comment, if there is one."""
    from dbc.tolerant import database_of

    comments = {}
    for message in database_of(codec.path).messages:
        comments[message.name] = message.comment or ""
        for signal in message.signals:
            comments[f"{message.name}.{signal.name}"] = signal.comment or ""
    return {name: text for name, text in comments.items() if text}


class _Source:
    """A log's blocks, counted. forward: correct the time with `LogTime`, except small disorder.

    Then a wrong stamp costs only its own frame, and a clock that was set back shifts later times.
    """

    def __init__(self, blocks: Iterable[Block], forward: bool) -> None:
        self._blocks, self._forward = blocks, forward
        self.read = self.dropped = self.steps = 0
        self.cut: LogError | None = None

    def __iter__(self) -> Iterator[Block]:
        """Iterate until the end of the log or a fault, which is then in `cut`."""
        blocks = self._counted()
        first = next(blocks, None)
        if first is None:
            return
        if not self._forward:
            yield from chain([first], blocks)
            return
        time = LogTime(first.t_ns.item(0), MS, disorder=True)
        for steady in time.steady(chain([first], blocks)):
            self.dropped += steady.dropped.size
            self.steps = time.steps
            if steady.block.size:
                yield steady.block

    def _counted(self) -> Iterator[Block]:
        try:
            for block in self._blocks:
                self.read += block.size
                if block.size:
                    yield block
        except LogError as error:
            self.cut = error


def convert(
    blocks: Iterable[Block], path: Path, make: Callable[[Path], Sink], *, strict: bool
) -> Done:
    """Write a log to `path`. Frames before a fault in the log are kept, unless `strict`.

    Raises LogError for a fault if `strict` or if nothing was read; BadLogError if there is nothing
    to write. Then no file is left.
    """
    source = _Source(blocks, ending(path) in ASCENDING)
    with whole(path) as part:
        sink = make(part)
        try:
            for block in source:
                sink.add(block)
            if source.cut is not None and (strict or not source.read):
                raise source.cut
            if not source.read:
                raise BadLogError(NO_FRAME)
        finally:
            sink.close()
        sink.left_out["time_back"] += source.dropped
        if not sink.written:
            raise NothingWrittenError(source.read, sink)
    cut = "" if source.cut is None else str(source.cut)
    return Done(source.read, sink, cut, source.steps)


class NothingWrittenError(BadLogError):
    """Frames were read, but none could be written."""

    def __init__(self, read: int, sink: Sink) -> None:
        self.sink = sink
        super().__init__(f"none of {read} frames could be written")

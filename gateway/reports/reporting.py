"""The files of `--results`: tables during the run, pictures and the report at its end.

Imported only if results are requested, so that a run without them has no extra cost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from dbc.codec import Codec
from dbc.frame import Nanos
from gateway.core.gateway import Gateway
from gateway.io.whole_file import write_text
from gateway.reports import run_figures, run_report
from gateway.reports.intervals import Intervals
from gateway.reports.page import literal
from gateway.reports.provenance import as_toml, program, sha256
from gateway.reports.record import Recorder
from gateway.reports.run_report import Run
from gateway.reports.ticks import MOST, TickLog, Use
from gateway.reports.timing import Timed, tables, timed
from gateway.reports.trace import Trace
from gateway.reports.truth import Truth, rows
from gateway.settings import calibration
from gateway.settings.config import Config

if TYPE_CHECKING:
    from gateway.io.live import LiveSnapshot
    from gateway.io.replay import Replayed
    from gateway.reports.expectations import Verdict
    from gateway.reports.truth import Row

Facts = list[tuple[str, str]]
MAX_NS: Final[Nanos] = 2**63 - 1


class Reporting(AbstractContextManager["Reporting"]):
    """Collects the data of one run: a context manager. For each tick `add_tick`, then `run`."""

    def __init__(self, folder: Path, config: Config, codec: Codec, together: int = MOST) -> None:
        """folder: for tables and pictures; created here, so that a failure is reported early.

        together: number of ticks that are processed together.

        Raises OSError.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self.truth: Truth | None = None
        self.timed: Timed | None = None
        self.recorder = Recorder(folder, config.nodes)
        self.trace = Trace(config.nodes)
        self.intervals = Intervals(config.nodes)
        self.uses: list[Use] = [
            self.recorder.add_ticks,
            self.trace.add_ticks,
            self.intervals.add_ticks,
        ]
        """Functions to which the ticks are passed."""
        self._ticks = TickLog(self.uses, together)
        self._config = config
        self._codec = codec
        self._gateway: Gateway | None = None

    def begin(self, gateway: Gateway) -> None:
        """Set the gateway whose ticks follow."""
        self._gateway = gateway

    def add_tick(self) -> None:
        """Add the last tick of the gateway."""
        assert self._gateway is not None
        self._ticks.append(self._gateway)

    @property
    def next_ns(self) -> Nanos:
        """See `Samples`: 0 before the first tick, then `MAX_NS`: the core keeps later ticks."""
        return MAX_NS if self._ticks.follows else 0

    def took(self, _now: Nanos, gateway: Gateway, _peak: NDArray[np.float64]) -> None:
        """See `Samples`."""
        self._ticks.follow(gateway)

    def add_truth(self, rows: Iterable[Row]) -> None:
        """Add rows of truth, whose time 0 is the first tick."""
        if self.truth is None:
            self.truth = Truth()
        self.truth.add_rows(rows)

    def set_timing(self, seen: LiveSnapshot, period_ns: int) -> None:
        """Keep the histograms of a run in real time. Raises OSError."""
        self.timed = timed(seen, period_ns)
        tables(self.folder, self.timed)

    def read_truth(self, path: Path) -> None:
        """Add the rows of truth that the process of the drives has written, if there are any.

        Their time 0 is the first frame of the drives, within a tick or two of the first tick.
        """
        if path.is_file():
            self.add_truth(rows(path))

    def close(self) -> None:
        """Finish the tables. Raises OSError."""
        self._ticks.flush()
        self.recorder.close()

    def __exit__(self, *error: Any) -> None:
        """Finish the tables, or remove them after an exception. Raises OSError."""
        if error[1] is None:
            self._ticks.flush()
        self.recorder.__exit__(*error)

    def run(
        self,
        title: str,
        facts: Facts,
        *,
        inside: str = "",
        verdicts: Sequence[Verdict] = (),
        notes: Sequence[str] = (),
        overload: str = "",
        step: Callable[[str], None] = lambda _what: None,
    ) -> Run:
        """Draw the pictures; return the data of the report. inside: path from report to folder.

        step: called with the name of each picture before it is drawn, N + 1 times.
        """
        gateway, config = self._gateway, self._config
        assert gateway is not None
        self._ticks.flush()
        self.intervals.close()
        if self.truth is not None:
            self.truth.close()
        word = f"ConfigHash {gateway.outbox.config_hash:06x}\n"
        write_text(self.folder / "configuration.txt", word)
        names = run_figures.draw(
            self.folder, self.trace, self.truth, config.adhesion.raise_probability, step
        )
        timing = self.timed and self.timed._replace(picture=f"{inside}{self.timed.picture}")
        return Run(
            title, facts, _configuration(config, self._codec, gateway), as_toml(config), self.trace,
            self.intervals, gateway.inbox.counts, self.truth, verdicts, timing,
            [f"{inside}{name}" for name in names], _bus(config), notes,
            overload,
        )  # fmt: skip


def leave(folder: Path, title: str, runs: Sequence[Run], *, single: bool) -> Path:
    """Write the report of these runs; return the path of its HTML file. Raises OSError."""
    run_report.leave(folder, title, runs, str(program()), single=single)
    return folder / "report.html"


def file_facts(path: Path, what: str) -> Facts:
    """Name, size and SHA-256 of a file. Raises OSError."""
    return [
        (what, literal(path.name)),
        ("SHA-256", f"`{sha256(path)}`"),
        ("size", f"{path.stat().st_size:,} bytes"),
    ]


def span_facts(trace: Trace, received: int) -> Facts:
    """Time, frames and drives of a run."""
    return [
        ("time", f"{trace.span_s:,.3f} s, {trace.ticks:,} ticks"),
        ("frames", f"{received:,}"),
        ("drives", _numbers(trace.nodes)),
    ]


def _numbers(nodes: tuple[int, ...]) -> str:
    """Nodes as text: `1 to 6` or `1, 3`."""
    if len(nodes) > 3 and nodes == tuple(range(nodes[0], nodes[0] + len(nodes))):
        return f"{nodes[0]} to {nodes[-1]}"
    return ", ".join(map(str, nodes))


def replay_facts(path: Path, done: Replayed, trace: Trace) -> Facts:
    """File, channel, span and first and last time of a replay."""
    first, last = (f"{ns // 10**9}.{ns % 10**9:09d}" for ns in (done.first_ns, done.last_ns))
    return [
        *file_facts(path, "log"),
        ("channel", literal(done.channel) if done.channel else "not named"),
        *span_facts(trace, done.frames),
        ("first frame, last frame", f"{first} s, {last} s on the log's own clock"),
        (
            "times",
            "in this report from the first frame; in `flags.csv` and `estimates.csv` on the "
            "log's own clock",
        ),
    ]


def _configuration(config: Config, codec: Codec, gateway: Gateway) -> Facts:
    a = config.adhesion
    cells = calibration.of(config)
    cells_text = "none: thermal flags stay unknown"
    if cells is not None and config.calibration_path is not None:
        cells_text = f"{literal(config.calibration_path.name)}, checksum `{cells.checksum()}`"
    return [
        ("hash, as on the bus (`ConfigHash`)", f"`{gateway.outbox.config_hash:06x}`"),
        ("estimator, detector", f"{config.estimator.kind.upper()}, {a.detector}"),
        ("loop", f"{config.loop.rate_hz} Hz"),
        ("DBC", literal(codec.path.name)),
        ("SHA-256 of the DBC", f"`{codec.digest}`"),
        ("thermal calibration", cells_text),
    ]


def _bus(config: Config) -> str:
    """Bit rates on which the bus load is based."""
    rate = f"at {config.bus.bitrate / 1e6:g} Mbit/s"
    return f"{rate} and {config.bus.data_bitrate / 1e6:g} Mbit/s for FD data"

"""The Python API: `import gateway`, then `gateway.replay(..)` and the other names of `__all__`.

Everything else is private and may change without notice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from html import escape
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from dbc.codec import Codec
from dbc.frame import Frame
from dbc.text import InputError
from estimators.detect import DETECTORS, WITH_MEMORY, Detector, Evidence, Opinion
from gateway.core import start_record
from gateway.core.gateway import Gateway
from gateway.io.extras import need
from gateway.io.log_file import OneChannel, open_log
from gateway.io.prepare import bound, prepare
from gateway.io.replay import Replayed, Sink
from gateway.io.replay import replay as run_log
from gateway.reports import known
from gateway.reports.record import (
    ESTIMATES_HEADER,
    FLAGS_HEADER,
    Change,
    Changes,
    Column,
    estimate_columns,
    flag_columns,
    in_words,
)
from gateway.reports.ticks import TickLog, Ticks
from gateway.settings.config import Config, ConfigError, load

if TYPE_CHECKING:
    import pandas as pd  # type: ignore[import-untyped]
    import pyarrow as pa

    from gateway.reports.reporting import Facts, Reporting

FilePath = str | PathLike[str]

detectors: Final = (*DETECTORS, *WITH_MEMORY)
"""Names for `[adhesion] detector`."""


class Run:
    """Output of the gateway in every tick of a run: tables, and the share of time it was known."""

    verdicts: tuple[Any, ...] = ()
    """For a scenario, one per expectation and drive: text, passed, detail, delay_ms, limit_ms."""

    def __init__(
        self, title: str, config: Config, codec: Codec, again: Callable[[Reporting], Facts]
    ) -> None:
        """Start empty; `add_tick` takes ticks. again: repeats the run, for a report."""
        self.title = title
        self._codec = codec
        self._again = again
        self.config = config
        self.frames: list[Frame] = []
        """Frames that the gateway sent."""
        self._flags: list[tuple[Column, ...]] = []
        self._estimates: list[tuple[Column, ...]] = []
        self._noted = Changes()
        self._ticks = TickLog((self._add_ticks,))
        self._first_ns: int | None = None
        self._last_ns = 0

    def add_tick(self, gateway: Gateway, sent: Iterable[Frame]) -> None:
        """Add the gateway's last tick, and the frames that it sent in this tick."""
        self._last_ns = gateway.now_ns
        if self._first_ns is None:
            self._first_ns = self._last_ns
        self.frames += sent
        self._ticks.append(gateway)

    def _add_ticks(self, ticks: Ticks) -> None:
        nodes = self.config.nodes
        self._noted.add_ticks(ticks, nodes)
        row = np.repeat(ticks.t_ns / 1e9, len(nodes)), np.tile(nodes, len(ticks.t_ns))
        self._flags.append((*row, *map(in_words, flag_columns(ticks))))
        self._estimates.append((*row, *map(in_words, estimate_columns(ticks))))

    @property
    def _changes(self) -> list[Change]:
        self._ticks.flush()
        return self._noted.changes

    @cached_property
    def flags(self) -> pa.Table:
        """A row for each tick and drive: the columns of `flags.csv`."""
        self._ticks.flush()
        return _table(FLAGS_HEADER, _joined(self._flags))

    @cached_property
    def estimates(self) -> pa.Table:
        """A row for each tick and drive, as in `estimates.csv`; null: not known."""
        self._ticks.flush()
        return _table(ESTIMATES_HEADER, _joined(self._estimates))

    @cached_property
    def events(self) -> pa.Table:
        """A row for each change of a flag: t_s, drive, flag, state."""
        rows = [(t_ns / 1e9, node, flag, word) for t_ns, node, flag, word in self._changes]
        return _table(("t_s", "drive", "flag", "state"), list(zip(*rows, strict=True)))

    @property
    def known(self) -> known.Shares:
        """Percent of the time in which each flag was not Unknown, by flag and drive."""
        first_ns = self._first_ns or 0
        return known.shares(self._changes, self.config.nodes, first_ns, self._last_ns)

    def to_pandas(self) -> pd.DataFrame:
        """Flags and estimates side by side, a row for each tick and drive.

        Raises ConfigError without pandas or pyarrow.
        """
        need(("pandas", "pyarrow"), "pandas", "to_pandas")
        return self.flags.to_pandas().merge(self.estimates.to_pandas(), on=["t_s", "drive"])

    def report(self, folder: FilePath) -> Path:
        """Run once more and write the report that `--results` writes; return the path of its HTML.

        Raises OSError.
        """
        from gateway.io.whole_file import whole_folder
        from gateway.reports.reporting import Reporting, leave

        with whole_folder(Path(folder)) as part:
            with Reporting(part, self.config, self._codec) as kept:
                facts = self._again(kept)
            run = kept.run(self.title, facts, verdicts=self.verdicts)
            report = leave(part, self.title, [run], single=True)
        return Path(folder) / report.name

    def __repr__(self) -> str:
        """One line: title, duration, shares of time with known flags."""
        seconds = (self._last_ns - (self._first_ns or 0)) / 1e9
        return f"<{self.title}: {seconds:.2f} s; known: {known.text(self.known)}>"

    def _repr_html_(self) -> str:
        """Table of the changes of flags, for a notebook."""
        first_s = (self._first_ns or 0) / 1e9
        rows = "".join(
            f"<tr><td>{t_ns / 1e9 - first_s:.3f}</td><td>{node}</td><td>{flag}</td>"
            f"<td>{word}</td></tr>"
            for t_ns, node, flag, word in self._changes
        )
        head = "<tr><th>s</th><th>drive</th><th>flag</th><th>state</th></tr>"
        return f"<p>{escape(repr(self)[1:-1])}</p><table>{head}{rows}</table>"


def replay(
    log: FilePath,
    config: Config | FilePath | None = None,
    *,
    channel: str | None = None,
    detector: str | Detector | None = None,
    start: FilePath | None = None,
) -> Run:
    """Run the gateway over a recorded log, in any format that `traction-gateway replay` reads.

    config: a file, a `Config`, or None for three drives on nodes 1 to 3. channel: one of several.
    detector: a name of `detectors`, or one of your own: called with an `Evidence`, it returns an
    `Opinion`; the configuration then names `median`. start: a start record of `traction-gateway
    shrink`, from which the gateway continues.
    Raises InputError or OSError.
    """
    own = None if detector is None or isinstance(detector, str) else detector
    named = detector if isinstance(detector, str) else None if own is None else "median"
    used, codec = _prepared(config, named)

    def begin_at(first_ns: int) -> Gateway:
        if start is None:
            gateway = Gateway(used, codec, first_ns)
        else:
            gateway = start_record.resumed(Path(start).read_bytes(), str(start), used, codec)
        if own is not None:
            gateway.adhesion.detector = own
        return gateway

    def play(sink: Sink) -> Replayed:
        blocks = OneChannel(open_log(Path(log), strict=False).blocks, channel, "channel=")
        return run_log(blocks, begin_at, used.loop.period_ns, sink)

    def again(kept: Reporting) -> Facts:
        from gateway.reports.reporting import replay_facts

        def keep(_now: int, _sent: Sequence[Frame], gateway: Gateway) -> None:
            kept.begin(gateway)
            kept.add_tick()

        return replay_facts(Path(log), play(keep), kept.trace)

    run = Run(Path(log).name, used, codec, again)
    play(lambda _now, sent, gateway: run.add_tick(gateway, sent))
    return run


class Scenario:
    """A scenario of drives, events and expectations; `run` checks them on a virtual clock."""

    def __init__(self, name: FilePath) -> None:
        """name: a file, or a scenario of the package. Raises InputError."""
        from sim.scenario import find

        self.scenario = find(str(name))

    def run(self, config: FilePath | None = None) -> Judged:
        """Run the simulated drives against the gateway. Raises InputError."""
        from gateway.hil.bench import run_virtual
        from gateway.hil.fitting import fitted

        path = None if config is None else Path(config)
        scenario, used, codec = fitted(path, self.scenario)

        def again(kept: Reporting) -> Facts:
            from gateway.reports.reporting import span_facts

            done = run_virtual(scenario, used, codec, left=kept)
            return span_facts(kept.trace, done.gateway.inbox.counts["received"])

        run = Judged(scenario.title, used, codec, again)
        outcome = run_virtual(
            scenario,
            used,
            codec,
            [lambda _now, _received, sent, gateway: run.add_tick(gateway, sent)],
        )
        run.verdicts = tuple(outcome.verdicts)
        return run


class Judged(Run):
    """A run with verdicts."""

    @property
    def passed(self) -> bool:
        """Whether every expectation held; False without one."""
        return bool(self.verdicts) and all(verdict.passed for verdict in self.verdicts)


def scenario(name: FilePath) -> Scenario:
    """A scenario from a file or of the package: `gateway.scenario("release").run()`."""
    return Scenario(name)


def _prepared(config: Config | FilePath | None, detector: str | None) -> tuple[Config, Codec]:
    changes: dict[str, Any] = {"adhesion": {"detector": detector}} if detector else {}
    if not isinstance(config, Config):
        return prepare(None if config is None else Path(config), **changes)
    if detector:
        load(None, **changes)  # raises ConfigError for another name
        adhesion = config.adhesion.model_copy(update={"detector": detector})
        config = config.model_copy(update={"adhesion": adhesion})
    return config, bound(config)


def _joined(parts: Sequence[tuple[Column, ...]]) -> list[Column]:
    return [np.concatenate(columns) for columns in zip(*parts, strict=True)]


def _table(names: Sequence[str], columns: Sequence[Column | tuple[object, ...]]) -> pa.Table:
    need(("pyarrow",), "pandas", "tables")
    import pyarrow as pa

    words = {*FLAGS_HEADER[2:], "flag", "state", "health", "fault_class"}
    columns = columns or ((),) * len(names)
    kinds = [pa.string() if n in words else pa.float64() if n != "drive" else pa.int64()
             for n in names]  # fmt: skip
    # `from_pandas` turns NaN into null.
    arrays = [
        pa.array(column, kind, from_pandas=True)
        for column, kind in zip(columns, kinds, strict=True)
    ]
    return pa.table(dict(zip(names, arrays, strict=True)))


__all__ = [
    "Config", "ConfigError", "Evidence", "Gateway", "InputError", "Judged", "Opinion", "Run",
    "Scenario", "detectors", "replay", "scenario",
]  # fmt: skip

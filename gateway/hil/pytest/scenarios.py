"""A scenario file as tests: one for each of its expectations."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from dbc.text import InputError
from gateway.hil.fitting import fitting
from gateway.hil.pytest.bench import HilBench
from gateway.hil.pytest.options import bus_of, expected_known, mutant_of
from gateway.reports import known
from gateway.reports.expectations import Verdict
from sim.scenario import Scenario, ScenarioError, load


class ScenarioFailure(Exception):
    """An expectation that did not hold; the text is the whole report."""


class ScenarioFile(pytest.File):
    """Collects the expectations; runs the scenario once, when the first of them is tested."""

    def collect(self) -> Iterator[pytest.Item]:
        """An item per expectation. Raises CollectError for a bad scenario or one without any."""
        try:
            self.scenario: Scenario = load(self.path)
        except ScenarioError as error:
            raise self.CollectError(str(error)) from None
        self.short: list[str] = []
        """A line per flag that was known for less of the time than expected."""
        self._outcome: list[list[tuple[Verdict, str]]] = []
        self._judged: set[int] = set()
        for number, expect in enumerate(self.scenario.expect):
            who = f"-{expect.drive}" if expect.flag in known.FLAGS else ""
            name = f"{number}-{expect.flag}{who}-{'never-' if expect.never else ''}{expect.is_}"
            yield ScenarioItem.from_parent(self, name=name, number=number)
        if not self.scenario.expect:
            raise self.CollectError(f"{self.path}: no [[expect]]: nothing would be tested")

    def verdicts(self, number: int) -> list[tuple[Verdict, str]]:
        """Verdicts of one expectation, one per drive, each with a picture.

        The second time, as for pytest-rerunfailures, they are those of a new run.
        """
        if not self._outcome or number in self._judged:
            self._outcome, self._judged = self._run(), set()
        self._judged.add(number)
        return self._outcome[number]

    def _run(self) -> list[list[tuple[Verdict, str]]]:
        from gateway.hil.bench import touched_drives
        from gateway.reports.expectations import judge

        config, codec = fitting(None, self.scenario)
        own = self.config.getoption("--hil-gateway") == "own"
        bus, mutant = bus_of(self.config), mutant_of(self.config)
        bench = HilBench(self.scenario, config, codec, bus, mutant, own_gateway=own)
        pictures: dict[int, str] = {}
        try:
            # The picture of an expectation is taken when its time has passed, not at the end.
            for at, number in sorted(
                (min(e.after_s + (e.within_ms or 1000.0) / 1000.0, self.scenario.duration_s), k)
                for k, e in enumerate(self.scenario.expect)
            ):
                bench.run(max(at - bench.now_s, 0.0))
                pictures[number] = bench.flags.show(
                    round(min(self.scenario.expect[number].after_s, bench.now_s) * 1e9)
                )
            bench.run(max(self.scenario.duration_s - bench.now_s, 0.0))
        finally:
            bench.close()
        seen = known.of_frames(bench.flags.track.seen, bench.nodes, 0)
        self.short = known.short_of(seen, expected_known(self.config))
        touched = touched_drives(self.scenario)
        return [
            [(verdict, pictures[k]) for verdict in judge([e], bench.flags.track, touched, 0)]
            for k, e in enumerate(self.scenario.expect)
        ]


class ScenarioItem(pytest.Item):
    """One expectation."""

    parent: ScenarioFile

    def __init__(self, *, number: int, **more: Any) -> None:
        """number: index of the expectation in the file."""
        super().__init__(**more)
        self.number = number

    def runtest(self) -> None:
        """Raises ScenarioFailure if it failed for a drive or flags were unknown for too long."""
        verdicts = self.parent.verdicts(self.number)
        if self.parent.short:
            raise ScenarioFailure("\n".join([*self.parent.short, verdicts[0][1]]))
        wrong = [(v, picture) for v, picture in verdicts if not v.passed]
        if wrong:
            failures = "\n".join(f"{v.text}: {v.detail}" for v, _ in wrong)
            raise ScenarioFailure(f"{failures}\n{wrong[0][1]}")
        self.add_report_section(
            "call", "verdicts", "\n".join(f"{v.text}: {v.detail}" for v, _ in verdicts)
        )

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """The text of a failure or of bad input, without a traceback through this plugin."""
        if isinstance(excinfo.value, ScenarioFailure | InputError | OSError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Any, int | None, str]:
        """File, no line, and the name shown in reports."""
        return self.path, None, f"{self.path.name}: {self.name}"

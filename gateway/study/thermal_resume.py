"""File of finished trials, train by train, with which a stopped reproduction goes on."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from gateway.study.thermal_scores import Score

FILE: Final = "trains.jsonl"
Row = tuple[str, Score]
"""Method and score."""


class Done:
    """Finished rows by base and seed; every train that is added is written at once."""

    def __init__(self, path: Path, program: str, *, resume: bool) -> None:
        """Read finished trains to resume; those of another `program` version are not used.

        Raises OSError.
        """
        self._path, self._program = path, program
        self._rows: dict[tuple[str, int], list[Row]] = {}
        if resume and path.is_file():
            for line in path.read_text(encoding="utf-8").splitlines():
                self._read_line(line)
        path.write_text("".join(map(self._as_json, self._rows)), encoding="utf-8")

    def _read_line(self, line: str) -> None:
        """Read one line; one that is cut, or from another version of the program, is ignored."""
        try:
            found = json.loads(line)
            rows = [(str(method), Score(*map(float, score))) for method, score in found["rows"]]
            key = str(found["base"]), int(found["seed"])
        except (ValueError, TypeError, KeyError):
            return
        if found.get("program") == self._program:
            self._rows[key] = rows

    def _as_json(self, key: tuple[str, int]) -> str:
        base, seed = key
        row: dict[str, Any] = {"program": self._program, "base": base, "seed": seed}
        row["rows"] = [[method, [*score]] for method, score in self._rows[key]]
        return json.dumps(row) + "\n"

    def missing(self, base: str, seeds: Iterable[int]) -> list[int]:
        """Seeds of the trains that must still be run."""
        return [seed for seed in seeds if (base, seed) not in self._rows]

    def add(self, base: str, seed: int, rows: Iterable[Row]) -> None:
        """Add a train's rows. Raises OSError."""
        key = base, seed
        self._rows[key] = list(rows)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(self._as_json(key))

    def scores(
        self, base: str, seeds: Sequence[int], names: Sequence[str]
    ) -> dict[str, list[Score]]:
        """Scores by method, in the order of the seeds."""
        out: dict[str, list[Score]] = {name: [] for name in names}
        for method, score in self._of(base, seeds):
            out[method].append(score)
        return out

    def _of(self, base: str, seeds: Sequence[int]) -> Iterator[Row]:
        for seed in seeds:
            yield from self._rows[base, seed]

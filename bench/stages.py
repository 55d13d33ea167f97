"""Where a tick's time goes: the gateway's stages, timed one by one in a replay.

Each stage is wrapped in a timer, which costs 0.1 to 0.2 us a call; a stage holds what it calls.
The stages are those of single steps, as live; a replay does most ticks several in a call.
"""

from __future__ import annotations

import tempfile
import time
from collections import defaultdict
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, Final
from unittest.mock import patch

from bench.speed import quiet
from bench.wire import log_of
from gateway import core
from gateway._direct import Direct
from gateway.receiving import Receiver
from gateway.ticks import Ticks

HEADER = ("stage", "per tick", "share of steps", "calls per tick")
STAGES: Final[tuple[tuple[str, type | ModuleType, str], ...]] = (
    ("whole step", core.Gateway, "step"),
    ("frames in: verify, decode, pair", core.Inbox, "take"),
    ("  verify, decode, pair, compiled", Receiver, "receive"),
    ("filters", core.Bank, "run"),
    ("measured motion", core.MotionMonitor, "observe"),
    ("detector and commands", core.AdhesionMonitor, "detect"),
    ("thermal readings", core.ThermalSide, "hear"),
    ("thermal reports", core.ThermalSide, "tell"),
    ("evidence", core.Flags, "collect_evidence"),
    ("flags", core.Flags, "debounce"),
    ("what is published", core.Flags, "publish"),
    ("frames out", core.Outbox, "due"),
    ("  due, encode, protect, compiled", Direct, "send"),
)


def rows() -> list[tuple[str, ...]]:
    """One row per stage; the first is the whole replay."""
    spent: dict[str, list[float]] = defaultdict(list)

    def timed(task: Any, name: str, *words: Any, **more: Any) -> Any:
        began = time.perf_counter()
        try:
            return task(*words, **more)
        finally:
            spent[name].append(time.perf_counter() - began)

    with tempfile.TemporaryDirectory() as name:
        log = log_of(Path(name), "traction.dbc")
        replay = partial(quiet, "replay", str(log), "-o", str(Path(name) / "out.log"))
        replay()
        began = time.perf_counter()
        replay()
        together = time.perf_counter() - began
        single = patch.object(Ticks, "_until", lambda _self, now: now)
        with single:
            began = time.perf_counter()
            replay()
            whole = time.perf_counter() - began
        patches = [
            single,
            *(
                patch.object(owner, entry, _wrapped(timed, getattr(owner, entry), what))
                for what, owner, entry in STAGES
                if owner is not Direct
            ),
        ]
        named = {entry: what for what, owner, entry in STAGES if owner is Direct}
        plain = Direct.__call__

        def called(self: Direct, *words: Any) -> Any:
            what = named.get(self.name)
            return plain(self, *words) if what is None else timed(plain, what, self, *words)

        patches.append(patch.object(Direct, "__call__", called))
        for each in patches:
            each.start()
        try:
            replay()
        finally:
            for each in patches:
                each.stop()
    ticks = len(spent["whole step"])
    out = [
        ("the whole command", _us(together / ticks), f"{100.0 * together / whole:.0f} %", ""),
        ("the whole command, every tick a step", _us(whole / ticks), "", "1.0"),
    ]
    for what, _, _ in STAGES:
        total = sum(spent[what])
        calls = len(spent[what]) / ticks
        out.append((what, _us(total / ticks), f"{100.0 * total / whole:.0f} %", f"{calls:.1f}"))
    return out


def _wrapped(timed: Any, task: Any, name: str) -> Any:
    def call(*words: Any, **more: Any) -> Any:
        return timed(task, name, *words, **more)

    return call


def _us(seconds: float) -> str:
    return f"{1e6 * seconds:.1f} us"

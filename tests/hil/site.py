"""A bus with a gateway, drives and somebody else who reads the flags, for tests of many rounds."""

from __future__ import annotations

import json
import random
import signal
import statistics
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from tests.hil.chain import Setting, memory_folder, setting
from tests.hil.observer import Observer, end_process
from tests.hil.stable import Stable
from tests.provenance import commit_of

if TYPE_CHECKING:
    from conftest import Vcan

CI_SHARE = 10
SCENARIO = 'title = "nothing happens"\nseed = 1\nduration_s = 100000\n'
SEED = "--campaign-seed"
KEPT = Path(__file__).with_name("campaign.jsonl")
"""A line per figure of each run in full."""


@dataclass
class Site:
    """The bus, the programs on it, and the observer."""

    vcan: Vcan
    used: Setting
    folder: Path
    stable: Stable
    rng: random.Random
    seed: int
    share: int
    messages: str
    """Which message set is on the bus."""
    gateway: int = 0
    drives: int = 0
    _started: list[int] = field(default_factory=list)

    def count(self, full):
        """How often, in this run."""
        return full // self.share

    @property
    def trap(self):
        """A file that stops the gateway between deciding and sending."""
        return self.folder / "trap"

    def run(self):
        """Start the gateway; its pid."""
        self.gateway = self.another_gateway("gateway.txt", self.trap)
        return self.gateway

    def another_gateway(self, log="another.txt", trap=None):
        """Start a gateway that is not `self.gateway`; its pid."""
        words = ("run", *self.used.bus, "--quiet", "--config", str(self.used.config))
        priority = 20 if self.vcan.own_kernel else 0
        return self._start(words, log, priority, trap)

    def drive(self, channel=""):
        """Start the drives, on another interface if one is named; their pid."""
        self.drives = self.more_drives(len(self.used.nodes), channel, "drives.txt")
        return self.drives

    def more_drives(self, count, channel="", log="more.txt"):
        """Start drives 1 to `count` that are not `self.drives`; their pid."""
        scenario = self.folder / f"{count}.toml"
        scenario.write_text(f"{SCENARIO}drives = {count}\n")
        words = ["sim", str(scenario), *self.used.bus, "--dbc", str(self.used.codec.path)]
        words[words.index("-c") + 1] = channel or self.vcan.name
        # Those that come later must not take the processor from those that are there, nor from us.
        priority = 10 if self.vcan.own_kernel and not self.drives else 0
        return self._start(words, log, priority)

    def _start(self, words, log, priority, trap=None):
        self._started.append(self.stable.start(words, self.folder / log, priority, trap))
        return self._started[-1]

    def kill(self, pid, number=signal.SIGKILL):
        """End a program and wait for it; how it ended."""
        end_process(pid, number)
        self._started.remove(pid)
        return self.stable.ended(pid, block=True)

    def note(self, what, **figures):
        """A line for the report; of a run in full it is kept."""
        print(f"{what}: " + ", ".join(f"{name} {value}" for name, value in figures.items()))
        if self.share == 1:
            run = {
                "seed": self.seed,
                "commit": commit_of(KEPT.parent),
                "kernel": "user-mode-linux" if self.vcan.own_kernel else "native",
                "messages": self.messages,
            }
            with KEPT.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"what": what, **figures, **run}) + "\n")

    def note_times(self, what, seconds, then="first flag frame"):
        """How long it took each time until `then`."""
        ordered = sorted(round(each, 3) for each in seconds)
        p99_s = ordered[int(0.99 * (len(ordered) - 1))]
        middle = round(statistics.median(ordered), 3)
        self.note(what, times=len(ordered), until=then, median_s=middle, p99_s=p99_s,
                  longest_s=ordered[-1])  # fmt: skip

    def observer(self):
        """Somebody else at the bus."""
        return Observer(self.vcan.name, self.used.codec.path, self.used.nodes)

    def check_alive(self):
        """Neither program has ended by itself."""
        for name, pid in (("gateway", self.gateway), ("drives", self.drives)):
            text = (self.folder / f"{name}.txt").read_text()
            assert self.stable.ended(pid) is None, f"{name} ended: {text[-2000:]}"

    def end(self):
        """Kill what still runs."""
        for pid in self._started:
            end_process(pid, signal.SIGKILL)


@contextmanager
def open_site(vcan, stable, config, more=""):
    """A site without programs. more: lines at the end of the gateway's configuration."""
    share = 1 if config.getoption("--counts") == "full" else CI_SHARE
    with memory_folder() as folder:
        used = setting(vcan, folder, drives=2, slower=vcan.own_kernel)
        used.config.write_text(used.config.read_text() + more)
        seed = config.getoption(SEED)
        messages = "traction.dbc" + (", currents every 5 ms" if vcan.own_kernel else "")
        site = Site(vcan, used, folder, stable, random.Random(seed), seed, share, messages)
        try:
            yield site
        finally:
            site.end()

"""What authenticated flags cost: the sender, its tick, and a receiver at peace and under attack."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import cycle
from typing import Final

from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.cmac import CMAC

from bench.speed import best
from dbc.codec import bind
from dbc.frame import MS
from dbc.secoc_receiver import WAITING, Verifier
from dbc.secoc_sender import Authenticator, Macs
from gateway.commands.check import bus_load
from gateway.core.gateway import Gateway
from gateway.settings.config import parse, shipped_dbc
from sim.scenario import find
from sim.simulation import Simulation

KEY: Final = bytes(range(16))
FLAG: Final = 0x1A0
COUNT: Final = 20_000
FULL_BUS: Final = 1_000_000 // 111
"""Frames of 8 bytes in a second of 1 Mbit/s, no bits stuffed."""
TICKS: Final = 1000
FRESH: Final = 1 << 40


def each_us(task: Callable[[], object]) -> float:
    """Shortest of five times `COUNT` calls, us a call."""

    def many() -> None:
        for _ in range(COUNT):
            task()

    return 1e6 * best(many, 5) / COUNT


def macs() -> list[tuple[str, ...]]:
    message, ready = bytes(20), CMAC(AES(KEY))

    def alone() -> bytes:
        mac = ready.copy()
        mac.update(message)
        return mac.finalize()

    def from_the_key() -> bytes:
        mac = CMAC(AES(KEY))
        mac.update(message)
        return mac.finalize()

    sender = Authenticator(KEY, 1)
    library, keyed = each_us(alone), each_us(from_the_key)
    ours = each_us(lambda: sender.sign(FLAG, bytes(8)))
    return [
        ("freshness and MAC of a flag frame", f"{ours:.2f} us",
         f"library alone, key ready {library:.2f} us", f"{ours / library:.2f}"),
        ("library alone, from the key each time", f"{keyed:.2f} us",
         f"key ready {library:.2f} us", f"{keyed / library:.2f}"),
    ]  # fmt: skip


def receiver() -> list[tuple[str, ...]]:
    """A genuine frame, and what a full bus of forgeries takes of a receiver's processor."""
    sender, macs_of = Authenticator(KEY, 1), Macs(KEY)
    one = each_us(lambda: macs_of.of(FLAG, bytes(8), FRESH))
    pairs = [(k.to_bytes(8, "big"), *sender.sign(FLAG, k.to_bytes(8, "big"))) for k in range(COUNT)]
    listener = Verifier(KEY, FRESH)

    def genuine() -> None:
        for k, (data, low, mac) in enumerate(pairs):
            listener.flag(FLAG, data, k * MS)
            listener.auth(low, mac, k * MS)

    began = time.perf_counter()
    genuine()
    spent = 1e6 * (time.perf_counter() - began) / COUNT
    assert listener.accepted == COUNT
    rows = [("receiver: a genuine pair", f"{spent:.2f} us", f"one MAC {one:.2f} us",
             f"{spent / one:.2f}")]  # fmt: skip
    for heard, what in (
        (True, "of a sender in step with it"),
        (False, "of a sender whose freshness it searches"),
    ):
        listener = Verifier(KEY, FRESH)
        if heard:
            sender = Authenticator(KEY, 1)
            data = bytes(8)
            listener.flag(FLAG, data, 0)
            listener.auth(*sender.sign(FLAG, data), 0)
        gap = 0 if heard else 1_000_000_000 // FULL_BUS
        began = time.perf_counter()
        for k in range(FULL_BUS):
            if k % 100 < WAITING:
                listener.flag(FLAG, bytes(8), k * gap)
            listener.auth(k & 0xFFFF, k, k * gap)
        spent = time.perf_counter() - began
        rows.append((f"receiver: a second of nothing but forged tags, {what}",
                     f"{1e3 * spent:.0f} ms", "real time 1 s", f"{spent:.3f}"))  # fmt: skip
    return rows


def ticks() -> tuple[str, ...]:
    """A whole tick with and without, the two in turns."""
    config = parse({})
    codec = bind(shipped_dbc("traction.dbc"), config.nodes)
    drives = Simulation(find("healthy"), codec)
    frames = [drives.step((), k * 10 * MS) for k in range(TICKS)]
    spent = {}
    for _, sender in zip(range(6), cycle((None, Authenticator(KEY, 1))), strict=False):
        gateway = Gateway(config, codec, 0, sender)
        began = time.perf_counter()
        for k, some in enumerate(frames):
            gateway.step(some, k * 10 * MS)
        took = 1e6 * (time.perf_counter() - began) / TICKS
        spent[sender is not None] = min(took, spent.get(sender is not None, took))
    return ("a tick with authenticated flags, 3 drives", f"{spent[True]:.0f} us",
            f"without {spent[False]:.0f} us", f"{spent[True] / spent[False]:.2f}")  # fmt: skip


def load() -> tuple[str, ...]:
    codec = bind(shipped_dbc("traction.dbc"), (1, 2, 3))
    without, with_it = (bus_load(codec, parse(s)) for s in ({}, {"authentication": {}}))
    return ("bus load with authenticated flags, 3 drives", f"{with_it:.1f} %",
            f"without {without:.1f} %", f"{with_it / without:.2f}")  # fmt: skip


def rows() -> list[tuple[str, ...]]:
    return [*macs(), ticks(), load(), *receiver()]

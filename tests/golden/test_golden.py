"""Golden logs: a recorded log in, the gateway's own frames out, compared line by line.

A change of behaviour shows here as a readable difference, to be committed with the change:
`pytest tests/golden --update-golden` writes the expected files anew; read the difference.
The inputs were made by `traction-gateway sim` from the scenario beside them, cut and packed;
they are stored, so that a change of the simulator cannot hide a change of the gateway.
"""

from __future__ import annotations

import difflib
from pathlib import Path

import pytest

from dbc.candump.reader import Reader
from dbc.codec import bind
from gateway.core.gateway import Gateway
from gateway.io.replay import replay
from gateway.settings.config import parse, shipped_dbc

HERE = Path(__file__).parent
CASES = {
    "loss": ("traction.dbc", (1, 2, 3), "vb"),
    "loss_median": ("traction.dbc", (1, 2, 3), "median"),
    "bad_bus": ("traction.dbc", (1, 2, 3), "vb"),
    "fd": ("traction_fd.dbc", (1, 2), "vb"),
    "slow": ("traction.dbc", (1, 2, 3), "vb"),
    "loss_switching": ("traction.dbc", (1, 2, 3), "switching"),
    "bad_bus_switching": ("traction.dbc", (1, 2, 3), "switching"),
    "fd_switching": ("traction_fd.dbc", (1, 2), "switching"),
}


def flag_log(log: Path, dbc: str, nodes: tuple[int, ...], detector: str) -> list[str]:
    """Every frame of the gateway as one line: time, name, raw bytes, signals as names."""
    config = parse(
        {
            "dbc": {"file": dbc},
            "drive": [{"node": n} for n in nodes],
            "adhesion": {"detector": detector},
        }
    )
    codec = bind(shipped_dbc(dbc), nodes)
    lines: list[str] = []
    absent = [n for n in range(1, 17) if n not in nodes]
    others = {f"{flag}{n}" for flag in ("Adhesion", "Thermal") for n in absent}

    def sink(now, out, view):
        for frame in out:
            spec = codec.by_id[frame.can_id]
            labels = {s.name: s.labels for s in spec.signals}
            words = [
                f"{name}={labels[name].get(int(reading.raw), f'{reading.value:g}')}"
                for name, reading in codec.decode(spec, frame.data).items()
                if name not in ("Crc", "Counter", "ConfigHash") and name not in others
            ]
            stamp = f"{frame.t_ns / 1e9:.6f}"
            data = frame.data.hex().upper()
            if spec.name == "Gateway_Info":
                data = "-"  # carries the configuration's hash, which names every new key
            lines.append(f"{stamp} {spec.name} {data} {' '.join(words)}")

    replay(Reader(log).blocks(), lambda start: Gateway(config, codec, start), 10_000_000, sink)
    return lines


@pytest.mark.parametrize("case", CASES)
def test_the_gateway_says_what_it_said(case, request):
    dbc, nodes, detector = CASES[case]
    log = HERE / f"{case.removesuffix(f'_{detector}')}.log.gz"
    expected = HERE / f"{case}.expected.txt"
    lines = flag_log(log, dbc, nodes, detector)
    assert len(lines) > 100
    if request.config.getoption("--update-golden"):
        expected.write_text("\n".join(lines) + "\n", encoding="utf-8")
    wanted = expected.read_text(encoding="utf-8").splitlines()
    difference = list(difflib.unified_diff(wanted, lines, "expected", "now", n=1, lineterm=""))
    assert not difference, "\n".join(difference[:60])


def test_a_golden_log_replayed_twice_gives_the_same_bytes():
    log = HERE / "loss.log.gz"
    assert flag_log(log, *CASES["loss"]) == flag_log(log, *CASES["loss"])

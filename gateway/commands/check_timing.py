"""`check`: bus load from the exact stuff bits of simulated drives, and duration of a tick."""

from __future__ import annotations

from collections import defaultdict

from dbc.codec import Codec
from dbc.frame import Frame
from dbc.spec import MessageSpec
from dbc.wire_time import bits_of
from gateway.hil.measured import MEASURE_NS, Measured
from gateway.settings.config import Config


def print_results(config: Config, codec: Codec, measured: Measured) -> None:
    """Print bus load and durations."""
    if config.unmapped() is not config:
        print("timing         measured with our message set for all drives, without translation")
    _print_loads(codec, config, measured.frames)
    _print_timing(measured.times_us, config.loop.period_ns / 1e3)


def _print_loads(codec: Codec, config: Config, frames: list[Frame]) -> None:
    """Print a line per kind of message: its share of the bus, with the frames' own stuff bits."""
    bus, seconds = config.bus, MEASURE_NS / 1e9
    nominal, data = bits_of(frames)
    kinds = defaultdict(list)
    for k, frame in enumerate(frames):
        spec = codec.by_id.get(frame.can_id)
        kinds["CANopen" if spec is None else _kind(spec)].append(k)
    busy_s = nominal / bus.bitrate + data / bus.data_bitrate
    shares = {name: 100.0 * sum(busy_s[of].tolist()) / seconds for name, of in kinds.items()}
    for name, share in sorted(shares.items(), key=lambda item: -item[1]):
        each = (nominal + data)[kinds[name]]
        rate = len(each) / seconds
        print(
            f"  {name:<24} {rate:7.0f} frames/s of {each.mean():5.1f} bits "
            f"({each.min()} to {each.max()}): {share:5.1f} %"
        )
    what = f"with the exact stuff bits of {seconds:g} s of simulated drives"
    print(f"  {'together':<24} {sum(shares.values()):5.1f} % {what}")


def _kind(spec: MessageSpec) -> str:
    return f"Drive{{n}}_{spec.kind}" if spec.node else spec.name


def _print_timing(times_us: list[float], period_us: float) -> None:
    ordered = sorted(times_us)
    p50, p99 = (ordered[int(len(ordered) * q)] for q in (0.5, 0.99))
    print(
        f"timing         a tick takes {p50:.0f} us of {period_us:.0f} us "
        f"({100 * p50 / period_us:.0f} %), p99 {p99:.0f} us, longest {ordered[-1]:.0f} us"
    )
    if late := sum(time_us > period_us for time_us in ordered):
        print(
            f"               {late} of {len(ordered)} ticks took longer than the period, so their "
            "flags would be late: free this machine, or lower [loop] rate_hz"
        )

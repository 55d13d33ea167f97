"""`check CONFIG`: everything that can be known before the first run."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from dbc.text import number_or_nan, printable
from gateway.commands.common import BAD_INPUT, GOOD, add_bus, add_line, add_signature
from gateway.io import quick_start
from gateway.io.console import note
from gateway.io.prepare import prepare
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dbc.codec import Codec
    from dbc.spec import MessageSpec
    from gateway.commands.check_loss import Tried
    from gateway.mapping.plan import Plan
    from gateway.settings.config import Config

LOAD_LIMIT_PERCENT = 80.0


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.description = (
        "Check a configuration before deployment: DBC, bus load and timing budget. Also simulate\n"
        "a loss of 50 % of the load on one drive of each type, and print after how many ms it is\n"
        "found. Exit 2 if it is not found within 1 s."
    )
    parser.add_argument("config", type=Path, help="the configuration to check")
    add_signature(parser)
    parser.add_argument("--eds", type=Path, action="append", default=[], metavar="FILE",
                        help="EDS or DCF of a drive: print what it sends, bit by bit")  # fmt: skip
    parser.add_argument("--log", type=Path, metavar="FILE",
                        help="a recording, whose first minute is compared with units, signs and "
                        "motor parameters; exit 2 if one does not fit")  # fmt: skip
    add_line(parser)
    parser.add_argument("--log-channel", metavar="NAME", help="channel, if the log has several")
    parser.add_argument("--forecast", type=_rpm, metavar="RPM",
                        help="print the smallest loss that will be found within 50 and 200 ms, at "
                        "5 to 100 %% of this rated speed; exit 2 if none is")  # fmt: skip
    parser.add_argument("-o", "--output", type=Path, metavar="DIR",
                        help="folder for forecast.csv and forecast.svg")  # fmt: skip
    parser.add_argument(
        "--no-timing", action="store_true", help="do not measure the timing of this machine"
    )


def _rpm(text: str) -> float:
    rpm = number_or_nan(text)
    if not 1.0 <= rpm <= 1e5:
        raise argparse.ArgumentTypeError(f"{text!r} is not a speed of 1 to 100000 rpm")
    return rpm


def more_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of a bus; they are apart because only they need python-can."""
    add_bus(parser)


class Problems(NamedTuple):
    """Problems by kind; blind: `unfound` are drives whose adhesion can never be known."""

    load_percent: float
    unfit: Sequence[str]
    unfound: Sequence[str]
    blind: bool

    @property
    def code(self) -> int:
        """Exit code."""
        return BAD_INPUT if self.unfound or self.unfit or self.too_much_load else GOOD

    @property
    def too_much_load(self) -> bool:
        """Whether the bus load is above the limit."""
        return self.load_percent > LOAD_LIMIT_PERCENT


def run(options: argparse.Namespace) -> int:
    """Print the results; exit 2 if the configuration cannot work, or would never find a loss."""
    return examine(options).code


@quick_start.unsearched()
def examine(options: argparse.Namespace) -> Problems:
    """Print the results and return the problems. Raises ConfigError, DbcMismatch, LogError."""
    from gateway.commands import check_loss
    from gateway.commands.check_signals import signal_lines
    from gateway.mapping import plan as foreign
    from gateway.settings import calibration

    if options.output is not None and options.forecast is None:
        raise ConfigError("--output", ["is for the files of --forecast RPM: give both"])
    config, codec = prepare(options.config, signature=options)
    planned, cells = config.all_of(lambda: foreign.plans(config), lambda: calibration.of(config))
    foreign.fitted(codec, planned, creep=config.adhesion.send_creep)
    word = calibration.config_hash(config, codec.digest, cells)
    print(f"configuration  good, hash {word:06x}")
    if "drive" not in config.model_fields_set:
        nodes = ", ".join(map(str, config.nodes))
        print(
            f"               no [[drive]] in it: drives {nodes} with motor {config.drive[0].motor}"
        )
    print(
        f"message set    {printable(codec.path.name)}: "
        f"{len(codec.messages)} messages fit the contract"
    )
    for line in signal_lines(planned):
        print(line)
    percent = bus_load(codec, config, planned)
    verdict = "good" if percent <= LOAD_LIMIT_PERCENT else "too much"
    print(f"bus load       {percent:.0f} % with worst-case stuffing, {verdict}")
    tried = _tried(config, codec, timing=not options.no_timing)
    print(f"heartbeats     {_heartbeats(config)}")
    for path in options.eds:
        from gateway.commands.check_eds import device_lines

        print("\n".join(device_lines(path, config)))
    unfit: list[str] = []
    if options.log is not None:
        from gateway.commands.check_log import print_findings

        unfit = print_findings(options.log, options.line, options.log_channel, config, codec)
    unfound = check_loss.print_results(config, tried)
    if options.forecast is not None:
        from gateway.commands.check_forecast import print_table

        unfound += print_table(config, codec, options.forecast, options.output)
    print(f"thermal        {_calibrated(config, planned)}")
    for line in calibration.promise_lines(cells, config.adhesion):
        print(f"promise        {line}")
    signed = f"by the owner of {options.public_key}" if config.sealed else "not checked"
    print(f"signature      {signed}")
    print(f"flags          {_authentication(config)}")
    _print_machine(options, config)
    problems = Problems(percent, unfit, unfound, len(tried.blind) == len(config.nodes))
    _note(problems, options.log)
    return problems


def _note(problems: Problems, log: Path | None) -> None:
    """Print the problems on stderr."""
    if problems.too_much_load:
        note(
            f"bus load {problems.load_percent:.0f} % is above {LOAD_LIMIT_PERCENT:.0f} %: use "
            "slower cycles in the DBC (GenMsgCycleTime), fewer drives on this bus, or CAN FD",
        )  # fmt: skip
    if problems.unfound:
        what = "" if problems.blind else "losses that would not be found: "
        note(what + "; ".join(problems.unfound))
    if problems.unfit:
        note(f"{log}: " + "; ".join(problems.unfit))


def _calibrated(config: Config, planned: Sequence[Plan]) -> str:
    """Text: whether thermal flags are possible with this configuration."""
    from gateway.mapping import lacks
    from gateway.settings.sections import FEWEST_COMPARED

    if config.calibration_path:
        return f"calibrated, method {config.thermal.method}"
    if config.thermal.method == "maisd":
        if len(config.nodes) < FEWEST_COMPARED:
            return "no flags: method 'maisd' compares the motors of two drives or more"
    elif len(planned) == len(config.nodes) and all(lacks.thermal(p.signals) for p in planned):
        return "no flags: every drive lacks signals that method 'model' needs, see above"
    return "not calibrated: flags stay unknown; run `traction-gateway calibrate`"


def _tried(config: Config, codec: Codec, *, timing: bool) -> Tried:
    """Simulate the losses; also print bus load and timing, if these messages can be simulated."""
    from gateway.commands import check_loss, check_timing
    from gateway.hil.measured import Measured

    if not timing:
        return check_loss.attempt(config, codec)
    ours = config.unmapped()
    measured = Measured(config)
    tried = simulated = check_loss.attempt(ours, codec, measured)
    if ours is not config:
        tried = check_loss.attempt(config, codec)
    if measured.times_us:
        check_timing.print_results(config, codec, measured)
    else:
        why = simulated.problem or "every drive is always Unknown"
        print(f"timing         not measured: {why}")
    return tried


def _print_machine(options: argparse.Namespace, config: Config) -> None:
    """Print settings of kernel and link, each with its cure; none changes the exit code."""
    from gateway.commands.run import bus_options
    from gateway.io import interface_settings as settings

    bus = bus_options(options, config)
    found = settings.machine()
    if bus.get("interface") == "socketcan" and bus.get("channel"):
        rates = (int(bus.get(key) or 0) for key in ("bitrate", "data_bitrate"))
        found += settings.link(str(bus["channel"]), *rates)
    else:
        print("link           not checked: name it with -i socketcan -c can0, or in [bus]")
    for what, finding, cure in found:
        print(f"{what:<14} {finding}{'' if cure else ', good'}")
        if cure:
            print(f"{'':<14} cure: {cure}")


def _heartbeats(config: Config) -> str:
    """Text: which heartbeats the gateway expects of the drives."""
    from gateway.core.gateway import HEARTBEAT_LIMIT_NS
    from gateway.core.supervision import TIMEOUT_PERIODS

    shortest = HEARTBEAT_LIMIT_NS // 1_000_000
    if (period := config.canopen.heartbeat_ms) is None:
        return (
            "optional, of any period: from its second heartbeat on, a node is lost after "
            f"{TIMEOUT_PERIODS} received periods of silence, at least {shortest} ms"
        )
    limit = max(shortest, TIMEOUT_PERIODS * period)
    return (
        f"every {period} ms: from its second heartbeat on, a node is lost after {limit} ms of "
        "silence"
    )


def _authentication(config: Config) -> str:
    if config.authentication is None:
        return "not authenticated"
    from gateway.io.credentials import flag_key

    try:
        flag_key(config.authentication.key, config.base)
    except ConfigError as error:
        # Keys exist only where the gateway runs; a configuration may be checked anywhere.
        return f"authenticated; no key here: {error.problems[0]}"
    return "authenticated, the key can be used"


def bus_load(codec: Codec, config: Config, planned: Sequence[Plan] = ()) -> float:
    """Bus load of the configured drives and the gateway, %.

    planned: drives of other makers, of which only the messages in use are known.
    """
    from dbc.wire_time import longest_seconds
    from gateway.core.transmit import VOUCHED, Outbox

    def seconds(spec: MessageSpec) -> float:
        rate = bus.data_bitrate if spec.brs else bus.bitrate
        return longest_seconds(spec.length, bus.bitrate, rate if spec.is_fd else None)

    creep = config.adhesion.send_creep
    outbox = Outbox(codec, config.nodes, 0, config.loop.period_ns, creep=creep)
    ours = set(outbox.specs)
    bus = config.bus
    busy = 0.0
    if config.authentication is not None:
        follows = sum(1e9 / outbox.specs[name].cycle_ns for name in VOUCHED)
        busy += seconds(outbox.auth) * follows
    mapped = {plan.node for plan in planned}
    native = [node for node in config.nodes if node not in mapped]
    theirs = {spec.key: spec for plan in planned for spec in plan.codec.messages}
    for spec in (*codec.messages, *theirs.values()):
        from_drive = spec.node in native and not spec.is_gateway
        used = from_drive or spec.name in ours or spec.key in theirs
        if spec.cycle_ns and used:
            busy += seconds(spec) * 1e9 / spec.cycle_ns
    theirs_hz = 1e3 / (config.canopen.heartbeat_ms or 100)
    heartbeats = longest_seconds(1, bus.bitrate) * (10 + theirs_hz * len(config.nodes))
    return 100.0 * (busy + heartbeats)

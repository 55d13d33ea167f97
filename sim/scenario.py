"""Scenarios: what the train does, what goes wrong, which flags are expected of the gateway.

A TOML file, read once, validated whole: every problem is listed with its path. The keys of the
contract are `title`, `seed`, `duration_s`, `drives`, `[[event]]`, `[[expect]]`; everything else has
a default. The same file runs on the virtual clock and on a real bus.

May know: names and numbers of events. May not know: bits, buses, how anything is simulated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import AfterValidator, Field, ValidationError, model_validator

from dbc.text import InputError, TomlError, near, printable, read_bytes, read_toml, toml_text
from dbc.toml_files import numbered, within
from dbc.value_errors import quoted
from sim.physics.adhesion import RAILS, rail
from sim.scenario_errors import problems_of
from sim.scenario_schema import (
    BusModel,
    Load,
    Mismatch,
    Motion,
    MotorChoice,
    Node,
    Number,
    Sensors,
    Span,
    Strict,
    ThermalStart,
    Time,
)

MAX_DRIVES: Final = 16
_SCENARIOS: Final = Path(__file__).with_name("scenarios")
Kind = Literal[
    "adhesion_loss", "rail", "overheating", "cooling_loss", "bearing", "sensor_stuck",
    "sensor_bias", "sensor_lost", "silent", "frame_loss", "corrupt", "phase_open",
    "friction_brake",
]  # fmt: skip
Sensor = Literal["stator", "drive_end", "non_drive_end", "ambient", "current"]

NEEDS: Final[dict[str, str]] = {
    "adhesion_loss": "depth", "rail": "value", "overheating": "either", "cooling_loss": "depth",
    "bearing": "either", "sensor_stuck": "none", "sensor_bias": "value", "sensor_lost": "none",
    "silent": "none", "frame_loss": "depth", "corrupt": "depth", "phase_open": "none",
    "friction_brake": "either",
}  # fmt: skip
"""Which of `depth` and `value` an event of this kind must carry."""
NEEDS_RAIL: Final = (
    "slip_limiter and friction_brake need a wheel on the rail: load.kind = 'rail', traffic = 'full'"
)
TICK_S: Final = 0.01
UNKNOWN_S: Final = 0.1
"""No flag is known before: thermal flags are sent every 100 ms, adhesion needs longer."""
TRAIN_FLAGS: Final = ("common_mode", "comm", "sensor")
SENSOR_KINDS: Final = ("sensor_stuck", "sensor_bias", "sensor_lost")


class ScenarioError(InputError):
    """A scenario that cannot be used. `problems` lists all of them, one line each."""

    def __init__(self, source: str, problems: list[str]) -> None:
        """`source`: the file or name it came from."""
        self.problems = tuple(map(printable, problems))
        super().__init__(f"{source}: " + "; ".join(self.problems))


class Event(Strict):
    """One `[[event]]`: a fault or a rail condition, from `at_s` for `for_s` (default: to the end).

    Most kinds need `depth`, a fraction (90 % is 0.9), or `value`:

    - `adhesion_loss`, `depth`: the rail carries (1 - depth) of the torque that the drive demands of
      the wheel. `ramp_s`: the loss begins and ends as a ramp of this duration, inside the event
    - `rail`, `value`: "dry", "wet", "leaves" or a friction coefficient
    - `overheating`, `value`: additional losses in the winding, W; or `depth` of rated copper loss
    - `cooling_loss`, `depth`: fraction of the air cooling that is lost (a tenth always remains)
    - `bearing`, `value`: additional friction losses, W; or `depth` of 60 W (more for a larger
      motor). `sensor`: `drive_end` (default) or `non_drive_end`
    - `sensor_bias`, `value`: offset of the reading, K (of the current in phase a, A, with
      `sensor = "current"`). `sensor_stuck`: the reading does not change. `sensor_lost`: the drive
      sends the not-available code. All three: `sensor`, by default `stator`
    - `silent`: the drive sends nothing, not even a heartbeat, and receives nothing
    - `frame_loss`, `depth`: probability that a frame is lost
    - `corrupt`, `depth`: probability that 1 to 3 bits of a frame change after its checksum was
      computed
    - `phase_open`: phase a carries no current. The drive does not detect it, and reports the
      voltage that it commands. It begins and ends at a multiple of 10 ms
    - `friction_brake`, `value`: torque of the brake at the motor's shaft, Nm; or `depth` of rated
      torque. The brake acts in addition to the motor, in steps of 10 ms, and can lock the wheel;
      `ramp_s` as above. While the brakes of all drives are applied, the motors coast: an interlock
      reduces the demand to 0 within 150 ms. If only some drives brake, their brakes drag: the
      demand does not change
    """

    at_s: Time
    for_s: Span | None = None
    drive: int | Literal["all"] = "all"
    kind: Kind
    depth: Annotated[float, within(0, 1, "", "a fraction: 90 % is 0.9")] | None = None
    value: Number | str | None = None
    ramp_s: Time = 0.0
    sensor: Sensor | None = None

    @model_validator(mode="after")
    def _fits_kind(self) -> Self:
        wrong = list(self._amount_problems())
        if self.ramp_s and self.kind not in ("adhesion_loss", "friction_brake"):
            wrong.append("ramp_s: belongs to adhesion_loss and friction_brake")
        if self.for_s is not None and 2 * self.ramp_s > self.for_s:
            wrong.append("ramp_s: two ramps do not fit into for_s")
        if self.sensor and self.kind not in (*SENSOR_KINDS, "bearing"):
            wrong.append("sensor: belongs to sensor_* and bearing")
        if self.kind == "bearing" and self.sensor not in (None, "drive_end", "non_drive_end"):
            wrong.append("sensor: a bearing is at the drive_end or the non_drive_end")
        if wrong:
            raise ValueError("\n".join(wrong))
        return self

    def _amount_problems(self) -> Iterator[str]:
        """What is wrong with `depth` and `value` for this kind of event."""
        need = NEEDS[self.kind]
        given = {k for k in ("depth", "value") if getattr(self, k) is not None}
        if need == "none" and given:
            yield f"{self.kind} takes neither depth nor value"
        if need in ("depth", "value") and given != {need}:
            yield f"{self.kind} needs {need} and nothing else"
        if need == "either" and len(given) != 1:
            yield f"{self.kind} needs depth or value"
        if self.depth == 0.0:
            yield "depth: 0 has no effect: expected more than 0, up to 1"
        if self.value is None:
            return
        if self.kind == "rail":
            try:
                rail(self.value)
            except ValueError as error:
                yield f"value: {error}{near(self.value, RAILS)}"
        elif isinstance(self.value, str):
            yield f"value: expected a number for {self.kind}, got {quoted(self.value)}"
        elif self.value == 0.0:
            yield "value: 0 has no effect"
        elif self.kind == "friction_brake" and self.value < 0.0:
            yield f"value: expected more than 0, got {self.value:g}: friction drives no wheel"

    @property
    def end_s(self) -> float:
        """End of the event; infinite without `for_s`."""
        return float("inf") if self.for_s is None else self.at_s + self.for_s

    @property
    def number(self) -> float:
        """`value` as a number, 0 where there is none."""
        return float(self.value) if isinstance(self.value, int | float) else 0.0


class Expect(Strict):
    """One `[[expect]]`: the expected state of a flag.

    - With `within_ms`: the flag must be in the state `is` at some time from `after_s` until
      `within_ms` later. A flag that is in this state before meets the expectation at once, after
      0 ms.
    - Without `within_ms`: at some time from `after_s` on.
    - With `never = true`: at no time from `after_s` on.

    `drive = "others"`: all drives that no event names. `common_mode`, `comm` and `sensor` are flags
    of the whole train: leave `drive` out.

    A flag that stays unknown proves nothing: `never` bad fails unless the flag was known at some
    time from `after_s` on, `never` good unless it was known at some time of the run. Unknown can be
    expected from 0.1 s on: before, no flag is known.
    """

    flag: Literal["adhesion", "thermal", "common_mode", "comm", "sensor"]
    is_: Literal["good", "bad", "unknown"] = Field(alias="is")
    drive: int | Literal["all", "others"] = "all"
    after_s: Time = 0.0
    within_ms: Annotated[float, within(1, 1e9, "ms", "flags are sent every 10 ms")] | None = None
    never: bool = False

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if self.never and self.within_ms is not None:
            raise ValueError("within_ms and never: give one of them")
        if self.flag in TRAIN_FLAGS and self.drive != "all":
            cure = "leave drive out, or expect adhesion or thermal of a drive"
            raise ValueError(f"drive: {self.flag} is a flag of the whole train: {cure}")
        if self.is_ == "unknown" and not self.never and self.after_s < UNKNOWN_S:
            raise ValueError(
                "after_s: every flag is unknown at the start, so this always holds: "
                f"expected {UNKNOWN_S:g} s or more, after the flag should have become known"
            )
        return self


class Scenario(Strict):
    """A whole scenario."""

    title: Annotated[str, AfterValidator(printable)] = Field(description="Name in all reports.")
    """Control characters in it are escaped: it goes to terminals, HTML and JUnit."""
    seed: Annotated[int, within(0, 2**64 - 1, "", "a whole number of 64 bits")] = Field(
        1, description="Of everything random. The same seed gives the same run."
    )
    duration_s: Annotated[float, within(0.01, 1e7, "s", "a tick is 0.01 s")]
    drives: int = Field(3, ge=1, le=MAX_DRIVES, description="Number of simulated drives.")
    nodes: list[Node] = Field(
        default_factory=lambda known: list(range(1, known.get("drives", 0) + 1)),
        min_length=1,
        description="Their node numbers, which `drive` names; by default 1 to `drives`, or with "
        "`--config` the configuration's first ones.",
    )
    traffic: Literal["full", "slow"] = Field(
        "full",
        description='"slow": the drives send only Motion, Status and Temperatures, and their '
        "motors are simulated in the steady state. For runs of hours.",
    )
    slip_limiter: Literal["none", "slow", "fast"] = Field(
        "fast",
        description="The drives' own slip control: fast holds a wheel at 5 % creep within "
        "milliseconds; slow at 15 % after half a second; none lets it run away.",
    )
    event: list[Event] = Field(default_factory=list)
    expect: list[Expect] = Field(default_factory=list)
    motor: MotorChoice = MotorChoice()
    load: Load = Load()
    mismatch: Mismatch = Mismatch()
    motion: Motion = Motion()
    sensors: Sensors = Sensors()
    thermal: ThermalStart = ThermalStart()
    bus: BusModel = BusModel()

    @model_validator(mode="before")
    @classmethod
    def _count_nodes(cls, given: Any) -> Any:
        nodes = given.get("nodes") if isinstance(given, Mapping) else None
        if isinstance(nodes, list) and 1 <= len(nodes) <= MAX_DRIVES:
            return {"drives": len(nodes), **given}
        return given

    @model_validator(mode="after")
    def _drives_exist(self) -> Self:
        wrong = [
            f"{where}[{k}].drive: {self.no_node(drive)}"
            for where, items in (
                ("event", [e.drive for e in self.event]),
                ("expect", [e.drive for e in self.expect]),
                ("load.disturbance", [d.drive for d in self.load.disturbance]),
                ("load.curve", [c.drive for c in self.load.curve]),
            )
            for k, drive in enumerate(items)
            if isinstance(drive, int) and drive not in self.nodes
        ]
        if len(set(self.nodes)) != self.drives:
            wrong.append(f"nodes: expected {self.drives} different numbers, one for each drive")
        wrong += self._late()
        wrong += [f"expect[{k}].{problem}" for k, problem in self._vacuous()]
        lists = {f"mismatch.{k}": getattr(self.mismatch, k) for k in ("R_s", "L_s", "psi_pm")}
        lists |= {"load.share": self.load.share, "load.wheel": self.load.wheel}
        wrong += [
            f"{where}: {len(values)} numbers for {self.drives} drives"
            for where, values in lists.items()
            if isinstance(values, list) and len(values) != self.drives
        ]
        if wrong:
            raise ValueError("\n".join(wrong))
        return self

    @model_validator(mode="after")
    def _detail_needs_the_full_plant(self) -> Self:
        if self.traffic == "slow" and (
            self.mismatch != Mismatch()
            or self.load.differs
            or any(e.kind == "phase_open" for e in self.event)
        ):
            raise ValueError(
                "traffic = 'slow' does not support mismatch, share, wheel or phase_open"
            )
        return self

    @model_validator(mode="after")
    def _creep_needs_a_rail(self) -> Self:
        slides = self.slip_limiter != "fast" or any(e.kind == "friction_brake" for e in self.event)
        if slides and (self.load.kind != "rail" or self.traffic == "slow"):
            raise ValueError(NEEDS_RAIL)
        return self

    def _late(self) -> Iterator[str]:
        """Events, changes of the load and expectations that begin after the scenario."""
        last_s = self.duration_s - TICK_S + 1e-9
        begins = [(f"event[{k}].at_s", e.at_s) for k, e in enumerate(self.event)]
        begins += [(f"load.disturbance[{k}].at_s", d.at_s)
                   for k, d in enumerate(self.load.disturbance)]  # fmt: skip
        begins += [(f"load.curve[{k}].at_s", c.at_s) for k, c in enumerate(self.load.curve)]
        begins += [(f"expect[{k}].after_s", e.after_s) for k, e in enumerate(self.expect)]
        for where, at in begins:
            if at > last_s:
                why = f"is not a tick ({TICK_S:g} s) before the end at {self.duration_s:g} s"
                yield f"{where}: {at:g} s {why}: it would have no effect"

    def _vacuous(self) -> Iterator[tuple[int, str]]:
        """Expectations that would check nothing, or less than they state: index and reason."""
        for k, expect in enumerate(self.expect):
            if expect.drive == "others" and not self.drives_of("others"):
                yield k, "drive: there are no others, because events name all drives"
            if self.traffic == "slow" and expect.flag in ("adhesion", "common_mode"):
                yield k, f"flag: {expect.flag} stays unknown with traffic = 'slow'"
            until_s = expect.after_s + (expect.within_ms or 0.0) / 1000.0
            if until_s > self.duration_s:
                end = f"the scenario ends at {self.duration_s:g} s"
                yield k, f"within_ms: until {until_s:g} s, but {end}"

    def drives_of(self, who: int | str) -> tuple[int, ...]:
        """Node numbers meant by `drive` of an event or an expectation."""
        if isinstance(who, int):
            return (who,)
        if who == "all":
            return tuple(self.nodes)
        named = {d for e in self.event for d in self.drives_of(e.drive)}
        return tuple(d for d in self.nodes if d not in named)

    @property
    def names_nodes(self) -> bool:
        """Whether the scenario itself says which nodes its drives are."""
        return "nodes" in self.model_fields_set

    def no_node(self, drive: int) -> str:
        """Message: there is no such node."""
        nodes = ", ".join(map(str, self.nodes))
        return f"{drive} is not one of the nodes {nodes}: name one of them"


def parse(table: Mapping[str, Any], source: str = "scenario", text: str = "") -> Scenario:
    """Scenario from a table as TOML gives it. Raises ScenarioError listing all that is wrong.

    text: the TOML, for the line numbers of the problems.
    """
    try:
        return Scenario.model_validate(table)
    except ValidationError as error:
        raise ScenarioError(source, numbered(problems_of(error, Scenario), text)) from None


def parse_text(text: str, source: str = "scenario") -> Scenario:
    """Scenario from TOML text. Raises ScenarioError listing all that is wrong."""
    try:
        table = read_toml(text)
    except TomlError as error:
        raise ScenarioError(source, [f"not TOML: {error}"]) from None
    return parse(table, source, text)


def find(name: str) -> Scenario:
    """A scenario file if there is one of that name, else one of the package's scenarios.

    Raises ScenarioError.
    """
    return load(name) if _is_file(name) else builtin(name)


def path_of(name: str) -> Path:
    """Path of the file that `find` reads. The file is not opened."""
    return Path(name) if _is_file(name) else _SCENARIOS / f"{name}.toml"


def _is_file(name: str) -> bool:
    return Path(name).is_file() or name.endswith(".toml")


def load(path: Path | str) -> Scenario:
    """Scenario from a file. Raises ScenarioError (also when the file cannot be read)."""
    path = Path(path)
    try:
        text = toml_text(read_bytes(path))
    except FileNotFoundError:
        raise ScenarioError(str(path), [_unknown("no such file", path.stem)]) from None
    except (OSError, TomlError) as error:
        raise ScenarioError(str(path), [f"cannot be read: {error}"]) from None
    return parse_text(text, str(path))


def builtin_names() -> tuple[str, ...]:
    """Names of the scenarios that come with the package."""
    return tuple(sorted(file.stem for file in _SCENARIOS.glob("*.toml")))


def builtin(name: str) -> Scenario:
    """A scenario of the package. Raises ScenarioError for an unknown name."""
    if name not in builtin_names():
        raise ScenarioError(name, [_unknown("no such file or scenario", name)])
    return parse_text((_SCENARIOS / f"{name}.toml").read_text(encoding="utf-8"), name)


def _unknown(problem: str, name: str) -> str:
    names = builtin_names()
    return f"{problem}; there are {', '.join(names)}{near(name, names)}"

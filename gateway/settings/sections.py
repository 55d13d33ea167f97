"""Sections of the configuration: every key with its bounds and the reason for them.

May know: numbers. May not know: files, buses, clocks, the DBC's contents.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Final, Literal, get_args

from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)

from dbc.toml_files import Strict, within
from estimators.adhesion_promise import promise_of
from estimators.tolerance import STORED, Promise
from gateway.settings.signal_map import Signals


class Extended(Strict):
    """Section to which keys were added: with their defaults its hash is the one before them."""

    ADDED: ClassVar[tuple[str, ...]]

    @model_serializer(mode="wrap")
    def _as_before(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        out: dict[str, Any] = handler(self)
        for key in self.ADDED:
            if getattr(self, key) == type(self).model_fields[key].default:
                out.pop(key, None)
        return out


Milliseconds = Annotated[
    int, within(0, 500, "ms", "half a second is too late for slip control: give it in ms")
]
Hold = Annotated[int, within(0, 5000, "ms", "longer than any flag needs: give it in ms")]
Seconds = Annotated[float, within(0, 3600, "s", "give it in seconds")]
Bitrate = Annotated[int, within(10_000, 1_000_000, "bit/s", "CAN has up to 1 Mbit/s: in bit/s")]
SensorName = Literal["stator", "drive_end", "non_drive_end"]
FEWEST_COMPARED: Final = 2
"""Fewest motors that method 'maisd' can compare."""
_NOISE = "a filter needs values near 1e-4, 1e-4, 1e-5, 1e-6, 0.1: give a variance per 125 us"
Variances = tuple[
    Annotated[float, within(1e-8, 1, "A2", _NOISE)],
    Annotated[float, within(1e-8, 1, "A2", _NOISE)],
    Annotated[float, within(1e-9, 0.1, "(rad/s)2", _NOISE)],
    Annotated[float, within(1e-10, 0.01, "rad2", _NOISE)],
    Annotated[float, within(1e-5, 1000, "Nm2", _NOISE)],
]


class Bus(Strict):
    """`[bus]`: python-can's own options; the command line overrides them."""

    interface: str | None = None
    channel: str | None = None
    bitrate: Bitrate = 1_000_000
    fd: bool = False
    data_bitrate: Annotated[
        int,
        within(10_000, 20_000_000, "bit/s", "CAN FD has up to 8 Mbit/s, CAN SIC XL 20: in bit/s"),
    ] = 5_000_000
    send_on: tuple[str, ...] | None = None
    on_intruder: Literal["unknown", "stop", "go_on", "tell"] | None = None
    """None: "unknown"; "tell" where flags are authenticated."""

    @property
    def options(self) -> dict[str, Any]:
        """Options of python-can that were given."""
        given = self.model_dump(exclude={"on_intruder", "send_on"})
        return {key: value for key, value in given.items() if value is not None}


class Loop(Strict):
    """`[loop]`: rate of the ticks."""

    rate_hz: int = 100

    @field_validator("rate_hz")
    @classmethod
    def _divides(cls, rate_hz: int) -> int:
        if rate_hz not in (100, 200, 500, 1000):
            msg = "expected 100, 200, 500 or 1000 Hz (a multiple of 100 that divides 1000)"
            raise ValueError(msg)
        return rate_hz

    @property
    def period_ns(self) -> int:
        """Tick period, ns."""
        return 1_000_000_000 // self.rate_hz


class Dbc(Strict):
    """`[dbc]`: a shipped file by name, or a path relative to the configuration."""

    file: str = "traction.dbc"


class Drive(Extended):
    """`[[drive]]`: one inverter on the bus."""

    ADDED = ("signals",)

    node: Annotated[int, within(1, 16, "", "the n of Drive{n}_PhaseCurrents")]
    motor: str = "bench"
    sensors: tuple[SensorName, ...] = get_args(SensorName)
    """Temperature sensors that the motor has; signals of other sensors are ignored."""
    signals: Signals | None = Field(None, description="of an inverter with messages of its own")

    @field_validator("sensors")
    @classmethod
    def _some_and_each_once(cls, sensors: tuple[SensorName, ...]) -> tuple[SensorName, ...]:
        if not sensors:
            raise ValueError(f"at least one is needed, of {', '.join(get_args(SensorName))}")
        twice = sorted({name for name in sensors if sensors.count(name) > 1})
        if twice:
            raise ValueError(f"{', '.join(twice)} is listed twice; name each sensor once")
        return sensors


class Estimator(Strict):
    """`[estimator]`: filter kind and noise, for a motor of 25 A and 30 Nm (scaled to others)."""

    kind: Literal["ekf", "ukf"] = "ekf"
    current_noise_var: Annotated[
        float, within(1e-8, 1, "A2", "variance of a sensor's noise for a motor of 25 A")
    ] = 2e-4
    """A^2, before quantisation."""
    process_noise: Variances = (1e-4, 1e-4, 1e-5, 1e-6, 0.1)
    """Variances added per 125 us: A^2, A^2, (rad/s)^2, rad^2, Nm^2 (adhesion-paper order)."""
    min_speed_rad_s: Annotated[
        float, within(1, 300, "rad/s", "give an electrical speed; below it flags stay unknown")
    ] = 20.0
    """Electrical speed; below it, load and angle are not observable."""


WITHOUT_MEMORY_MS: Final = {"raise_ms": 20, "raise_severe_ms": 10, "clear_ms": 30}
"""Default times of detectors that evaluate each tick by itself."""


class FaultFree(Strict):
    """`[adhesion] fault_free`: what `traction-gateway calibrate --adhesion` has measured."""

    minutes: Annotated[int, within(1, 10**8, "", "whole minutes of fault-free logs")]
    longest_ms: tuple[
        Annotated[int, within(0, 60_000, "ms", "no evidence lasts longer in a minute")], ...
    ]
    """Longest time for which evidence of a loss has lasted, in the worst minutes, descending."""

    @field_validator("longest_ms")
    @classmethod
    def _descending(cls, times: tuple[int, ...]) -> tuple[int, ...]:
        if not 1 <= len(times) <= STORED or list(times) != sorted(times, reverse=True):
            raise ValueError(
                f"1 to {STORED} times, which must descend: use the line that "
                "`traction-gateway calibrate --adhesion` prints"
            )
        return times


class Adhesion(Extended):
    """`[adhesion]`: detector and the timing of its flag."""

    ADDED = ("tolerance", "reuse", "send_creep", "false_alarms_per_1000_h", "fault_free")

    detector: Literal[
        "vb", "switching", "median", "kmeans", "vmp", "paper_vb", "paper_vb_reuse"
    ] = "switching"
    observe: Literal["torque", "speed", "both"] = "torque"
    tolerance: Annotated[
        float, within(0, 1, "", "give a share of the bound; 1 stops after one iteration")
    ] = 0.0
    """For the paper's VB: sweeps end once the bound grows by less; 0: five sweeps."""
    reuse: Annotated[float, within(0, 0.99, "", "at 1 new data would have no effect")] = 0.0
    """For the paper's VB: share of the last posterior in the next prior; 0: none, or 0.5 with
    `paper_vb_reuse`."""
    spread_nm: Annotated[
        float,
        within(0.01, 6, "Nm", "for 30 Nm rated; a wider spread hides the loss of half a load"),
    ] = 0.7
    """Load spread of healthy drives, at 30 Nm."""
    raise_probability: Annotated[
        float, within(0.71, 0.999, "", "0.7 means undecided: give a larger value")
    ] = 0.9
    clear_probability: Annotated[
        float, within(0.01, 0.69, "", "0.7 means undecided: give a smaller value")
    ] = 0.5
    raise_ms: Milliseconds = 10
    """The defaults of this and the next two are 10 ms longer for a detector without memory."""
    raise_severe_ms: Milliseconds = 0
    """Used where a loss is certain; with detectors other than `switching`, where a third of the
    load is missing."""
    clear_ms: Hold = 20
    good_ms: Hold = 50
    """Good evidence needed before the first `Adhering`."""
    send_creep: bool = False
    """Whether `Drive{n}_Adhesion` is sent: creep and utilisation of each drive, every 20 ms."""
    false_alarms_per_1000_h: (
        Annotated[float, within(0.001, 60_000, "", "per 1000 h of operation; needs fault_free")]
        | None
    ) = Field(None, description="stated rate for the train; needs `fault_free`")
    """The time after which a loss is flagged follows: `estimators.adhesion_promise`."""
    fault_free: FaultFree | None = Field(None, description="printed by `calibrate --adhesion`")

    @property
    def promise(self) -> Promise | None:
        """Promise of the stated rate of false alarms; None where no rate is stated."""
        if self.false_alarms_per_1000_h is None or self.fault_free is None:
            return None
        measured = self.fault_free
        return promise_of(measured.minutes, measured.longest_ms, self.false_alarms_per_1000_h)

    @property
    def raised_after_ms(self) -> tuple[int, int]:
        """Time after which a loss is flagged, and a certain one; no earlier than promised."""
        least = 0 if self.promise is None else int(self.promise.limit)
        return max(self.raise_ms, least), max(self.raise_severe_ms, least)

    @model_validator(mode="before")
    @classmethod
    def _times(cls, given: Any) -> Any:
        """Give detectors without memory longer times: `switching` has used several ticks."""
        if not isinstance(given, dict) or given.get("detector", "switching") == "switching":
            return given
        return {**WITHOUT_MEMORY_MS, **given}


class Thermal(Extended):
    """`[thermal]`: without a calibration the thermal flags stay unknown."""

    ADDED = ("false_alarms_per_1000_h",)

    calibration: str | None = None
    method: Literal["model", "maisd"] = "model"
    limit_k: Annotated[
        float, within(0.1, 300, "K", "give the allowed temperature rise over the other motors")
    ] = 10.0
    """How much warmer than the others a motor may become."""
    window_s: Annotated[
        float, within(0.1, 3600, "s", "give the length of the moving average in s")
    ] = 5.0
    """Window of the causal moving average."""
    raise_s: Seconds = 1.0
    clear_s: Seconds = 5.0
    false_alarms_per_1000_h: (
        Annotated[float, within(0.001, 1000, "", "per 1000 h of operation: 1 is usual")] | None
    ) = None
    """The alarm limit follows from this rate: `estimators.thermal.promise`."""


class Canopen(Extended):
    """`[canopen]`: the gateway sends NMT (node-addressed) only with `nmt_master`."""

    ADDED = ("heartbeat_ms",)

    nmt_master: bool = False
    heartbeat_ms: int | None = Field(None, ge=1, le=65_535)

    @property
    def heartbeat_ns(self) -> int:
        """Configured period of the drives' heartbeats, ns; 0: as received."""
        return 1_000_000 * (self.heartbeat_ms or 0)


class Authentication(Strict):
    """`[authentication]`: if present, flags are authenticated. It names files, never keys."""

    key: str = Field("auth.key", min_length=1)
    trip: str = Field("trip", min_length=1)

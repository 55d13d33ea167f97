"""The tables of a scenario file apart from its events: motor, load, motion, sensors, heat, bus.

May know: names and numbers. May not know: bits, buses, how anything is simulated.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from dbc.text import near
from dbc.toml_files import Within as Bounds
from dbc.toml_files import within
from sim.physics.adhesion import RAILS, rail
from sim.physics.plant import MOTORS, Motor

Time = Annotated[float, within(0, 1e7, "s", "give it in seconds from the start")]
Span = Annotated[
    float, within(0.001, 1e7, "s", "give it in seconds; what is shorter has no effect")
]
Node = Annotated[int, within(1, 16, "", "the n of Drive{n}_PhaseCurrents")]
Number = Annotated[float, within(-1e6, 1e6, "", "too large for a train: check its unit")]
Positive = Annotated[float, within(1e-7, 1e6, "", "a parameter of the motor, in SI units")]
Points = Annotated[list[tuple[Time, Number]], Field(min_length=1)]
Factor = Annotated[float, within(0.01, 100, "", "a factor; 1 changes nothing")]
Factors = Factor | list[Factor]
"""One number for all drives, or one per drive."""
Within = Annotated[float, Field(ge=0, lt=1)]
"""Largest deviation of a factor drawn from the seed."""


OWN: Final = ("R_s", "L_s", "psi_pm", "pole_pairs", "J", "I_rated", "T_rated", "U_dc")
"""Parameters that are needed for a motor of one's own."""
_MOTORS: Final = f"one of {', '.join(MOTORS)}"
_BITRATE: Final = Bounds(10_000, 1_000_000, "bit/s", "in bit/s; 0 for a bus without one, as vcan")


class Strict(BaseModel):
    """Unknown keys are rejected; values are frozen."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, populate_by_name=True, allow_inf_nan=False
    )


class MotorChoice(Strict):
    """`[motor]`: `name` (bench, large or traction_350kw), or the parameters of another motor.

    The parameters are in SI units, at the motor's shaft. `U_dc` is the voltage of the dc link, `B`
    the viscous friction. All but `B` and `k_p` are needed.
    """

    name: str = "bench"
    R_s: Positive | None = None
    L_s: Positive | None = None
    psi_pm: Positive | None = None
    pole_pairs: int | None = Field(None, ge=1, le=100)
    J: Positive | None = None
    I_rated: Positive | None = None
    T_rated: Positive | None = None
    U_dc: Positive | None = None
    B: Annotated[float, within(0, 100, "Nm s", "friction per rad/s of the rotor")] = 0.0
    k_p: Annotated[float, within(0.5, 3, "", "1.5 for amplitude-invariant values")] = 1.5

    @model_validator(mode="before")
    @classmethod
    def _table(cls, given: Any) -> Any:
        if isinstance(given, str):
            raise ValueError(f'expected [motor] name = "..", {_MOTORS}; got motor = {given!r}')  # noqa: TRY004
        return given

    @model_validator(mode="after")
    def _known(self) -> Self:
        given = [key for key in OWN if getattr(self, key) is not None]
        missing = [key for key in OWN if key not in given]
        if given and missing:
            raise ValueError(f"a motor with its own parameters also needs {', '.join(missing)}")
        named = "name" in self.model_fields_set
        if named and (given or {"B", "k_p"} & self.model_fields_set):
            raise ValueError("give either name or the motor's own parameters, not both")
        if self.name not in MOTORS:
            own = "for another give its parameters"
            meant = near(self.name, MOTORS)
            raise ValueError(f"name: unknown motor {self.name!r}: {_MOTORS}; {own}{meant}")
        return self

    @property
    def own(self) -> bool:
        """Whether its parameters are given here."""
        return self.R_s is not None

    @property
    def machine(self) -> Motor:
        """The motor that is simulated."""
        if not self.own:
            return MOTORS[self.name]
        return Motor(**self.model_dump(exclude={"name"}))


class Disturbance(Strict):
    """`[[load.disturbance]]`, only with `kind = "preset"`: a load that falls and returns.

    Half a period of a sine with this amplitude is subtracted from the drive's load, from `at_s` for
    `for_s`.
    """

    drive: int
    at_s: Time
    for_s: Span
    amplitude_nm: Number


class Curve(Strict):
    """`[[load.curve]]`: a healthy drive whose share of the load rises and returns, as in a curve.

    Its share is multiplied by 1 + `amount` times half a period of a sine, in steps of 10 ms.
    """

    drive: int
    at_s: Time
    for_s: Span
    amount: float = Field(ge=-0.5, le=0.5)


class Load(Strict):
    """`[load]`: what the drives work against.

    - `kind = "rail"`: `torque_nm` is the train's resistance for each drive (gradient and running
      resistance). `kind = "preset"`: it is the load of each drive without a fault.
    - `profile` = [[t_s, Nm], ...] replaces `torque_nm`. It is linear between the points; with
      `transition = "normal_cdf"` it has steps instead, smoothed by a normal distribution with the
      standard deviation `smooth_s`.
    - `rail`: the condition at the start, "dry", "wet", "leaves" or a friction coefficient.
    - `share`: the constant share of each drive, 1 = as demanded; one number, or one for each drive.
      With a preset load it scales the load. On the rail it scales the axle load and the torque
      that the drive delivers; the command that the drive reports is that of the train.
    - `wheel`: the wheel diameters, 1 = nominal. A smaller wheel turns faster.
    - `share_within`, `wheel_within`: multiply by a factor of 1 +- this value, which the seed draws
      for each drive.
    """

    kind: Literal["rail", "preset"] = "rail"
    torque_nm: Number = 18.0
    profile: Points | None = None
    transition: Literal["linear", "normal_cdf"] = "linear"
    smooth_s: Annotated[float, within(1e-6, 1e4, "s", "of the normal distribution")] = 0.00375
    rail: float | str = "dry"
    disturbance: list[Disturbance] = []
    curve: list[Curve] = []
    share: Factors = 1.0
    share_within: Within = 0.0
    wheel: Factors = 1.0
    wheel_within: Within = 0.0

    @property
    def differs(self) -> bool:
        """Whether the drives' healthy loads or speeds ever differ."""
        plain = self.share == self.wheel == 1.0 and not self.share_within and not self.wheel_within
        return not plain or bool(self.curve)

    @field_validator("rail")
    @classmethod
    def _known_rail(cls, given: float | str) -> float | str:
        try:
            rail(given)
        except ValueError as error:
            raise ValueError(f"{error}{near(given, RAILS)}") from None
        return given

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.disturbance and self.kind != "preset":
            raise ValueError("disturbance needs kind = 'preset'")
        if self.profile and [t for t, _ in self.profile] != sorted({t for t, _ in self.profile}):
            raise ValueError("times in profile must increase")
        return self


class Motion(Strict):
    """`[motion]`: the speed of the train, electrical rad/s, or rotor rpm with `unit = "rpm"`.

    `profile` = [[t_s, speed], ...] replaces `speed` and is linear between the points.
    `start = "rolling"`: the run starts at the profile's first speed. `angle_rad`: initial
    electrical angle of all drives; without it, it is random for each. `effort_nm`: the largest
    torque that is demanded of each drive on the rail; by default 1.5 T_rated.
    """

    speed: Number = 100.0
    profile: Points | None = None
    unit: Literal["rad_s", "rpm"] = "rad_s"
    start: Literal["rolling", "standstill"] = "rolling"
    angle_rad: Number | None = None
    effort_nm: Annotated[float, within(0.01, 1e6, "Nm", "torque of each drive")] | None = None

    @model_validator(mode="after")
    def _rises(self) -> Self:
        if self.profile and [t for t, _ in self.profile] != sorted({t for t, _ in self.profile}):
            raise ValueError("times in profile must increase")
        return self


class Sensors(Strict):
    """`[sensors]`: errors of the drives' sensors.

    Currents have white noise in each phase, an offset and a gain that are the same in all phases,
    and a range. `current_offset_within_a` and `current_gain_within`: for each drive and phase the
    seed draws an additional offset and gain, at most +- this value. Temperatures have noise and
    constant offsets, which differ from sensor to sensor; both values are one sigma.
    """

    current_noise_var: Annotated[float, within(0, 1e6, "A2", "a variance, of each phase")] = 2e-4
    current_offset_a: Number = 0.0
    current_gain: Factor = 1.0
    current_offset_within_a: Annotated[float, within(0, 1e6, "A", "up to +- that")] = 0.0
    current_gain_within: Within = 0.0
    current_range_a: Annotated[float, within(0.1, 1e6, "A", "where the sensors saturate")] = 600.0
    temperature_noise_k: Annotated[float, within(0, 100, "K", "one sigma")] = 0.15
    temperature_offset_k: Annotated[float, within(0, 100, "K", "one sigma")] = 0.3


class Mismatch(Strict):
    """`[mismatch]`: how far the motors deviate from the data sheet, which the drives' control uses.

    Factors on R_s, L_s and psi_pm, one number or one for each drive. `R_s_within` and the others
    multiply by a factor of 1 +- this value, which the seed draws for each drive. A drive with
    weaker magnets delivers less torque than commanded, but reports (`Motion.Torque`) the torque
    that the magnets of the data sheet would give.
    """

    R_s: Factors = 1.0
    R_s_within: Within = 0.0
    L_s: Factors = 1.0
    L_s_within: Within = 0.0
    psi_pm: Factors = 1.0
    psi_pm_within: Within = 0.0


class ThermalStart(Strict):
    """`[thermal]`: temperatures of the motors and of the air.

    `start`: "equilibrium" (the steady state at the first load and speed), "ambient", or one
    temperature of all parts. `ambient_profile` = [[t_s, degC], ...] replaces `ambient_c` and is
    linear between the points. `train_seed` draws the differences between motors and between
    sensors: with the same value it is the same train.
    """

    start: (
        Literal["equilibrium", "ambient"]
        | Annotated[float, within(-60, 300, "degC", "of all nodes")]
    ) = "equilibrium"
    ambient_c: Annotated[float, within(-40, 60, "degC", "of the air around the train")] = 20.0
    ambient_profile: Points | None = None
    train_seed: int = Field(1, ge=0)


class BusModel(Strict):
    """`[bus]`: time stamps follow from arbitration at this bit rate; 0: no bit rate, as vcan."""

    bitrate: int = 1_000_000
    data_bitrate: Annotated[
        int, within(10_000, 20_000_000, "bit/s", "CAN FD has up to 8 Mbit/s: in bit/s")
    ] = 5_000_000

    @field_validator("bitrate")
    @classmethod
    def _none_or_real(cls, bitrate: int) -> int:
        return int(_BITRATE(bitrate)) if bitrate else 0

"""The eight targets: what is called with an input, how long inputs are, words of the grammar."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

from tests.fuzzing.candump import candump, readers
from tests.fuzzing.frames import frames
from tests.fuzzing.texts import config, dbc, scenario
from tests.fuzzing.tick import tick
from tests.fuzzing.values import values

CORPUS: Final = Path(__file__).with_name("corpus")


class Target(NamedTuple):
    """run: raises where a promise is broken, else says how many `items` the input had."""

    name: str
    run: Callable[[bytes], int]
    items: str
    longest: int
    tokens: tuple[bytes, ...]
    run_all: Callable[[bytes], int]
    """As `run`, with every check that `run` makes of some inputs only."""
    is_slow: bool = True
    """Slow enough for a mutator in Python that knows words and numbers; else libFuzzer's own."""

    def corpus(self):
        """The inputs kept in the repository, in order of their names."""
        return [path.read_bytes() for path in sorted((CORPUS / self.name).iterdir())]


def _words(text):
    return tuple(word.replace("~", " ").replace("^", "\n").encode() for word in text.split())


_LOG = _words(
    "( ) . # ## _ _9 _F R R8 r R8_F 123 7FF 800 20000040 9FFFFFFF 00000123 (1.000000) ^ ~can0~ ~R "
    "(1.000000000) (8999999999.999999999) (9000000000.000000) ~ ~T #1 #0 #3AA ## .. 00.11.22 ; // "
    "DROPCOUNT:~dropped~3~CAN~frames~on~'can0'~socket~(total~drops~3) 45123#81:00:12345678#11.22 "
    "(1.000000)~can0~123#1122^ (2.000001)~can0~123#11223344556677 000102030405060708 \x0d \x1f \x09"
)
_FRAMES = tuple(
    bytes(piece)
    for piece in (
        (0xC3,), (0xC4,), (0xC0,), (0xC6,), (0xC7,), (0x00, 0x80), (0x00, 0x82), (0x44, 0x81),
        (0x80, 0x81, 0x01, 0, 0, 0, 8), (0x80, 0x01, 0x07, 0, 0, 0, 1), (0x80, 0x81, 0, 0, 0, 0, 8),
        (0x80, 0xA0, 0x01, 0, 0, 0, 8), (0xC1, 0xC2), (0xFF,) * 8, (0xC7, 0, 0, 0, 0, 0, 0, 0x80),
        (0x41, 4), (0x41, 2), (0x41, 8), (0x42, 7), (0x43, 1, 0), (0x7F, 0xFF), (0, 0x80, 8),
    )
)  # fmt: skip
_VALUES = tuple(bytes((what, 0, 0, 31)) for what in range(12))
_TICK = (
    *(bytes((0x90, place, 0, 0, how)) for place in range(0, 256, 16) for how in (0, 6, 10, 18)),
    bytes((0x40, 0, 3, 0xFF)), bytes((0x41, 1, 7, 0x80)), bytes((0x80, 0)), bytes((0x82, 0, 0)),
    bytes((0x83, 0, 0)),
    bytes((0x70, 1, 7, 0, 0, 0, 1, 0, 5)), bytes((0x70, 1, 7, 0, 0, 0, 1, 0, 127)),
)  # fmt: skip
_TOML = (
    "[ ] [[ ]] = { } , ' \" ''' \"\"\" # \\u0000 \\u000a \\U0010ffff true false inf nan -inf "
    "1979-05-27T07:32:00Z 07:32:00 0x7fffffffffffffff a.b.c ~=~ ^ [x]^ x~=~1^ \\n é "
)
_CONFIG = _words(
    _TOML + "[bus] [loop] [dbc] [[drive]] [motor.x] [motor.bench] [estimator] [adhesion] [thermal] "
    "[canopen] interface channel bitrate fd data_bitrate on_intruder rate_hz file node motor "
    "sensors R_s L_s psi_pm pole_pairs J B k_p I_rated T_rated kind current_noise_var base "
    "process_noise min_speed_rad_s detector observe spread_nm raise_probability raise_ms good_ms "
    "clear_probability clear_ms raise_severe_ms calibration method limit_k window_s raise_s clear_s"
    " false_alarms_per_1000_h"
    ' nmt_master "stator" "drive_end" "vb" "paper_vb" "speed" "ukf" "maisd" "go_on"'
)
_SCENARIO = _words(
    _TOML + 'title seed duration_s drives traffic "slow" [[event]] [[expect]] [motor] [load] '
    "[mismatch] [motion] [sensors] [thermal] [bus] [[load.disturbance]] [[load.curve]] at_s for_s "
    'drive kind depth value ramp_s sensor "all" "others" "rail" "bearing" "adhesion_loss"'
    ' "phase_open" "sensor_bias" "dry" "current" flag is after_s within_ms never '
    '"friction_brake" slip_limiter "none" "slow" '
    'share wheel R_s points "ambient" "equilibrium" start_c'
)
_DBC = _words(
    'BO_ SG_ BU_: VAL_ BA_ BA_DEF_ BA_DEF_DEF_ CM_ VERSION "" ; : | @ 1+ 0- @1- M m0 m1 m0M '
    "SIG_VALTYPE_ SG_MUL_VAL_ EV_ BO_TX_BU_ VAL_TABLE_ SIG_GROUP_ Vector__XXX ENUM INT FLOAT "
    'STRING HEX "GenMsgCycleTime" "VFrameFormat" "E2EProfile" "P02" "E2EDataIdList" "CANFD_BRS" '
    '"GenSigStartValue" Crc Counter Drive1_Motion Gateway_Faults (0,0) (1,0) [0|0] (1e-320,1e308) '
    '^ NS_: BS_: VECTOR__INDEPENDENT_SIG_MSG 2147483649 "NotAvailable" 0-0, 1-65535 \xff BA_REL_ '
    'DEFAULT_RANGE_ "SystemSignalLongSymbol" "SignalType" " BU_SG_REL_ @0+ (-1,0)'
)

TARGETS: Final = {
    target.name: target
    for target in (
        Target("candump", candump, "lines", 80, _LOG, partial(candump, every=1), is_slow=False),
        Target("readers", partial(readers, tokens=_LOG), "lines", 4000, _LOG,
               partial(readers, tokens=_LOG)),
        Target("frames", frames, "frames", 160, _FRAMES, partial(frames, every=1), is_slow=False),
        Target("tick", tick, "ticks", 200, _TICK, partial(tick, every=1), is_slow=False),
        Target("values", values, "ticks", 33, _VALUES, values),
        Target("dbc", dbc, "codecs", 1500, _DBC, dbc),
        Target("config", config, "configurations", 6000, _CONFIG, partial(config, every=1)),
        Target("scenario", scenario, "scenarios", 6000, _SCENARIO, scenario),
    )
}  # fmt: skip

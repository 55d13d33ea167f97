"""NumPy types of the core's records in `gateway/core/records.h`, with the compiler's layout.

Fields are read by name, `state[c]["counter"]`; that file describes them and gives their units.
"""

from __future__ import annotations

from copy import deepcopy
from functools import cache
from typing import Any, Final

import numpy as np
from _traction_core import ffi
from numpy.typing import NDArray

Records = NDArray[np.void]
"""One record per row."""
Columns = np.recarray[Any, np.dtype[Any]]
"""Records read by columns: `filters.x` is (N, 5), `filters.steps[k] = 0` writes into record k."""


_NAMES: Final = {"_cffi_double_complex_t": "complex128", "size_t": "uintp"}
"""NumPy's name of a type for which cffi uses another name."""


@cache
def dtype_of(ctype: Any) -> Any:
    """The NumPy type of a C type: struct, array, integer, floating-point number or address."""
    if ctype.kind == "struct":
        fields = ctype.fields
        return np.dtype({
            "names": [name for name, _ in fields],
            "formats": [dtype_of(field.type) for _, field in fields],
            "offsets": [field.offset for _, field in fields],
            "itemsize": ffi.sizeof(ctype),
        })  # fmt: skip
    if ctype.kind == "array":
        return np.dtype((dtype_of(ctype.item), (ctype.length,)))
    if ctype.kind == "pointer":
        return np.dtype(np.uintp)
    return np.dtype(_NAMES.get(ctype.cname, ctype.cname.removesuffix("_t")))


def zeros(n: int, dtype: Any) -> Columns:
    """Return n records of zeros."""
    return np.zeros(n, dtype).view(np.recarray)


def pointer(ctype: str, array: NDArray[Any]) -> Any:
    """Address of a contiguous array as a pointer to numbers or records of this C type.

    Raises ValueError for an array that is not contiguous. The array has to outlive its use.
    """
    return ffi.from_buffer(f"{ctype}[]", array)


E2E_CONFIG: Final = dtype_of(ffi.typeof("struct e2e_config"))
E2E_STATE: Final = dtype_of(ffi.typeof("struct e2e_state"))
FLAG: Final = dtype_of(ffi.typeof("struct flag"))
FLAG_RULES: Final = dtype_of(ffi.typeof("struct flag_rules"))
FLAG_INPUTS: Final = dtype_of(ffi.typeof("struct flag_inputs"))
TRAIN_INPUTS: Final = dtype_of(ffi.typeof("struct train_inputs"))
DRIVE_EVIDENCE: Final = dtype_of(ffi.typeof("struct drive_evidence"))
DRIVE_STATUS: Final = dtype_of(ffi.typeof("struct drive_status"))
TRAIN_STATUS: Final = dtype_of(ffi.typeof("struct train_status"))
VB_PRIORS: Final = dtype_of(ffi.typeof("struct vb_priors"))
LOAD_SPREAD: Final = dtype_of(ffi.typeof("struct load_spread"))
LOAD_RATIO: Final = dtype_of(ffi.typeof("struct load_ratio"))
LOAD_OBSERVATION: Final = dtype_of(ffi.typeof("struct load_observation"))
COMMAND_RESPONSE: Final = dtype_of(ffi.typeof("struct command_response"))
SIGNAL: Final = dtype_of(ffi.typeof("struct signal"))
MESSAGE: Final = dtype_of(ffi.typeof("struct message"))
MUX_RANGE: Final = dtype_of(ffi.typeof("struct mux_range"))
SIGMA_MIXED_CONFIG: Final = dtype_of(ffi.typeof("struct sigma_mixed_config"))
SIGMA_MIXED_SAMPLE: Final = dtype_of(ffi.typeof("struct sigma_mixed_sample"))
THERMAL_PARAMETERS: Final = dtype_of(ffi.typeof("struct thermal_parameters"))
THERMAL_INPUT: Final = dtype_of(ffi.typeof("struct thermal_input"))
STEP_CONFIG: Final = dtype_of(ffi.typeof("struct step_config"))
IMM_CONFIG: Final = dtype_of(ffi.typeof("struct imm_config"))
IMM_SURROUNDINGS: Final = dtype_of(ffi.typeof("struct imm_surroundings"))
IMM_STATE: Final = dtype_of(ffi.typeof("struct imm_state"))
THERMAL_SUMS: Final = dtype_of(ffi.typeof("struct thermal_sums"))
THERMAL_MOTOR_CONFIG: Final = dtype_of(ffi.typeof("struct thermal_motor_config"))
THERMAL_CONFIG: Final = dtype_of(ffi.typeof("struct thermal_config"))
THERMAL_MOTOR: Final = dtype_of(ffi.typeof("struct thermal_motor"))
MOTOR_CURRENT: Final = dtype_of(ffi.typeof("struct motor_current"))
HYPOTHESIS_CONFIG: Final = dtype_of(ffi.typeof("struct hypothesis_config"))
HYPOTHESIS_SPREAD: Final = dtype_of(ffi.typeof("struct hypothesis_spread"))
HYPOTHESIS_STATE: Final = dtype_of(ffi.typeof("struct hypothesis_state"))
PMSM: Final = dtype_of(ffi.typeof("struct pmsm"))
FILTER_SAMPLE: Final = dtype_of(ffi.typeof("struct filter_sample"))
ACQUISITION_LIMITS: Final = dtype_of(ffi.typeof("struct acquisition_limits"))
ACQUISITION: Final = dtype_of(ffi.typeof("struct acquisition"))
CURRENT_CALIBRATION: Final = dtype_of(ffi.typeof("struct current_calibration"))
FILTER: Final = dtype_of(ffi.typeof("struct filter"))
DRIVE_ESTIMATE: Final = dtype_of(ffi.typeof("struct drive_estimate"))
FILTER_TRACK: Final = dtype_of(ffi.typeof("struct filter_track"))
ESTIMATOR: Final = dtype_of(ffi.typeof("struct estimator"))
DRIVE_LOAD: Final = dtype_of(ffi.typeof("struct drive_load"))
ADHESION: Final = dtype_of(ffi.typeof("struct adhesion"))
SOCKET_VECTOR: Final = dtype_of(ffi.typeof("struct socket_vector"))
SOCKET_MESSAGE: Final = dtype_of(ffi.typeof("struct socket_message"))
ROTOR: Final = dtype_of(ffi.typeof("struct rotor"))
ROTOR_INPUTS: Final = dtype_of(ffi.typeof("struct rotor_inputs"))
TEMPERATURE_DRIVE: Final = dtype_of(ffi.typeof("struct temperature_drive"))
FILTER_NOISE: Final = dtype_of(ffi.typeof("struct filter_noise"))
FILTER_SETTINGS: Final = dtype_of(ffi.typeof("struct filter_settings"))
CHANNEL: Final = dtype_of(ffi.typeof("struct channel"))
SEQUENCE_GUARD: Final = dtype_of(ffi.typeof("struct sequence_guard"))
DRIVE_INPUT: Final = dtype_of(ffi.typeof("struct drive_input"))
HEARTBEAT: Final = dtype_of(ffi.typeof("struct heartbeat"))
SUPERVISION: Final = dtype_of(ffi.typeof("struct supervision"))
ID_ENTRY: Final = dtype_of(ffi.typeof("struct id_entry"))
RECEIVER: Final = dtype_of(ffi.typeof("struct receiver"))
TX_SIGNAL: Final = dtype_of(ffi.typeof("struct tx_signal"))
TX_MESSAGE: Final = dtype_of(ffi.typeof("struct tx_message"))
TX_FRAME: Final = dtype_of(ffi.typeof("struct tx_frame"))
TRANSMITTER: Final = dtype_of(ffi.typeof("struct transmitter"))
BUS_LOAD: Final = dtype_of(ffi.typeof("struct bus_load"))
TREND: Final = dtype_of(ffi.typeof("struct trend"))
THERMAL_MONITOR: Final = dtype_of(ffi.typeof("struct thermal_monitor"))
MOTOR_TEMPERATURES: Final = dtype_of(ffi.typeof("struct motor_temperatures"))
TEMPERATURE_MONITOR: Final = dtype_of(ffi.typeof("struct temperature_monitor"))
TEMPERATURE_LOG: Final = dtype_of(ffi.typeof("struct temperature_log"))
INTERFACE_NAME: Final = dtype_of(ffi.typeof("struct interface_name"))
TEXT_HEAD: Final = dtype_of(ffi.typeof("struct text_head"))
DRIVE_CHANNELS: Final = dtype_of(ffi.typeof("struct drive_channels"))
INPUT_STATUS: Final = dtype_of(ffi.typeof("struct input_status"))
MOTION: Final = dtype_of(ffi.typeof("struct motion"))
PLAUSIBILITY: Final = dtype_of(ffi.typeof("struct plausibility"))
MOTION_MONITOR: Final = dtype_of(ffi.typeof("struct motion_monitor"))
INTEGRITY: Final = dtype_of(ffi.typeof("struct integrity"))
SWITCHING: Final = dtype_of(ffi.typeof("struct switching"))
SWITCHING_LOAD: Final = dtype_of(ffi.typeof("struct switching_load"))
SWITCHING_NOISE: Final = dtype_of(ffi.typeof("struct switching_noise"))
SWITCHING_DRIVE: Final = dtype_of(ffi.typeof("struct switching_drive"))
SWITCHING_HYPOTHESIS: Final = dtype_of(ffi.typeof("struct switching_hypothesis"))
GATEWAY: Final = dtype_of(ffi.typeof("struct gateway"))
TICK_LOG: Final = dtype_of(ffi.typeof("struct tick_log"))
TICK_ROW: Final = dtype_of(ffi.typeof("struct tick_row"))
DRIVE_ROW: Final = dtype_of(ffi.typeof("struct drive_row"))


class Addressed:
    """An object whose records hold addresses of its arrays; a copy gets those of its own arrays."""

    def link(self) -> None:
        """Create everything that depends on the addresses of the arrays."""
        raise NotImplementedError

    def __deepcopy__(self, memo: dict[int, Any]) -> Addressed:
        """Copy the arrays and link the copy to them."""
        made = type(self).__new__(type(self))
        memo[id(self)] = made
        for name, value in vars(self).items():
            if not isinstance(value, ffi.CData):
                setattr(made, name, deepcopy(value, memo))
        made.link()
        return made

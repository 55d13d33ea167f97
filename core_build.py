"""Build of the compiled core: a setuptools backend, and what cffi is told.

The core is C11 in `dbc/`, `estimators/` and `gateway/core/`, one file per station; the loops of the
simulator are C in `sim/`. cffi reads the headers as they are, so no layout and no prototype is
written twice. The result is one module, `_traction_core`, for every Python from 3.11 on. Without a
C compiler ziglang brings one, from pip.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import sysconfig
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403 - everything else of the backend as it is

ROOT = Path(__file__).parent
HEADERS = (
    "gateway/core/records.h",
    "dbc/e2e.h",
    "dbc/decode.h",
    "dbc/encode.h",
    "dbc/socketcan.h",
    "estimators/detect/variational.h",
    "estimators/detect/load_reference.h",
    "estimators/detect/command_response.h",
    "estimators/detect/switching.h",
    "estimators/detect/switching_noise.h",
    "estimators/elementary.h",
    "estimators/maisd.h",
    "estimators/thermal/gaussian_mixture.h",
    "estimators/thermal/sigma_mixed.h",
    "estimators/thermal/model.h",
    "estimators/thermal/step_detector.h",
    "estimators/thermal/peers.h",
    "estimators/thermal/imm.h",
    "estimators/thermal/imm_update.h",
    "estimators/thermal/residuals.h",
    "estimators/thermal/monitor.h",
    "estimators/thermal/hypotheses.h",
    "estimators/trigonometry.h",
    "estimators/acquisition.h",
    "estimators/current_calibration.h",
    "estimators/adaptation.h",
    "estimators/filter.h",
    "estimators/load_observer.h",
    "gateway/core/flags.h",
    "gateway/core/sample_clock.h",
    "gateway/core/train.h",
    "gateway/core/adhesion.h",
    "gateway/core/switching_loss.h",
    "gateway/core/creep.h",
    "gateway/core/estimate.h",
    "gateway/core/temperature.h",
    "gateway/core/supervision.h",
    "gateway/core/sequence.h",
    "gateway/core/pairing.h",
    "gateway/core/receive.h",
    "gateway/core/busload.h",
    "gateway/core/transmit.h",
    "estimators/thermal/trend.h",
    "gateway/core/thermal_evidence.h",
    "gateway/core/thermal.h",
    "gateway/core/thermal_log.h",
    "dbc/candump_read.h",
    "dbc/candump_write.h",
    "dbc/text_read.h",
    "sim/records.h",
    "sim/physics/plant.h",
    "sim/physics/thermal.h",
    "gateway/core/inputs.h",
    "gateway/core/motion.h",
    "gateway/core/plausibility.h",
    "gateway/core/integrity.h",
    "gateway/core/tick.h",
    "gateway/core/tick_log.h",
    "gateway/core/table_text.h",
    "estimators/detect/paper_vb.h",
    "estimators/detect/message_passing.h",
    "estimators/thermal/rivals/ekf.h",
)
"""In the order in which they build on one another."""
PACKAGES = ("dbc", "estimators", "gateway", "sim")
GUEST = "gateway/hil/vcan/guest/whole_registers.c"
"""A program of its own, which is not of the core."""


def _files(ending: str) -> list[str]:
    """Files of all packages with this ending."""
    paths = (path for package in PACKAGES for path in (ROOT / package).rglob(f"*{ending}"))
    return sorted(path.relative_to(ROOT).as_posix() for path in paths)


SOURCES = tuple(source for source in _files(".c") if source != GUEST)
DEPENDS = (*_files(".h"), "estimators/filter_simd.c")
"""All that sources include."""
FLAGS = ("-std=c11", "-O3", "-ffp-contract=off", "-fno-math-errno")
"""No contraction: the same bytes whatever instructions a machine has. No errno: a root is one
instruction. The linker binds our names to our functions (-Bsymbolic), never to those of another
library in the process."""


def declarations() -> str:
    """The headers as cffi reads them: without includes and include guards."""
    text = "\n".join((ROOT / header).read_text() for header in HEADERS)
    kept = [
        line for line in text.splitlines()
        if not line.startswith("#") or re.match(r"#define \w+ +\d", line)
    ]  # fmt: skip
    return re.sub(r"/\*.*?\*/", "", "\n".join(kept), flags=re.DOTALL)


def compiler() -> list[str]:
    """The C compiler, as a command: CC, `cc`, or the one in ziglang."""
    if given := os.environ.get("CC"):
        return given.split()
    if shutil.which("cc"):
        return ["cc"]
    return [sys.executable, "-m", "ziglang", "cc"]


def builder() -> Any:
    """What setuptools builds `_traction_core` by. CORE_FLAGS in the environment: more flags."""
    from cffi import FFI

    # As the linker binds them, functions may be inlined in others of their source: the same bytes.
    flags = [*FLAGS, "-fno-semantic-interposition", *os.environ.get("CORE_FLAGS", "").split()]
    made = FFI()
    made.cdef(declarations())
    includes = "\n".join(f'#include "{header}"' for header in HEADERS)
    made.set_source(
        "_traction_core", includes, sources=list(SOURCES), include_dirs=["."],
        depends=list(DEPENDS), extra_compile_args=flags, libraries=["m"], py_limited_api=True,
    )  # fmt: skip
    command = " ".join(compiler())
    os.environ.setdefault("CC", command)
    os.environ.setdefault("LDSHARED", f"{command} -shared -Wl,-Bsymbolic")
    return made


def _more(asked: list[str]) -> list[str]:
    need = shutil.which("cc") is None and "CC" not in os.environ and find_spec("ziglang") is None
    return [*asked, "ziglang==0.17.1"] if need else asked


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """A compiler too, where there is none."""
    return _more(build_meta.get_requires_for_build_wheel(config_settings))


def get_requires_for_build_editable(config_settings: Any = None) -> list[str]:
    """The same."""
    return _more(build_meta.get_requires_for_build_editable(config_settings))


def leave_sizes(folder: str) -> None:
    """Python's `pyconfig.h` where Debian's dispatcher looks for it: for both processors.

    Debian keeps one in a folder of each processor, and installs that of its own. What the limited
    API takes of it, the sizes of C types, is the same for both.
    """
    general = Path(sysconfig.get_config_h_filename())
    own = general.parents[1] / str(sysconfig.get_config_var("MULTIARCH")) / general.parent.name
    for what in ("x86_64", "aarch64"):
        there = Path(folder) / f"{what}-linux-gnu" / general.parent.name
        there.mkdir(parents=True, exist_ok=True)
        shutil.copy(own / general.name if own.exists() else general, there / general.name)

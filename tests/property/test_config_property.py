"""Every number of a configuration has bounds; within them nothing raises, beyond is one line."""

import math
import types
from typing import Annotated, Any, Union, get_args, get_origin

import pytest
from annotated_types import Ge, Gt, Interval, Le, Lt
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pydantic import AfterValidator, BaseModel

from dbc.codec import bind
from dbc.toml_files import Within
from gateway.core.gateway import Gateway
from gateway.hil.synthetic_loss import losses
from gateway.settings.config import Config, ConfigError, parse
from tests.fuzz import examples
from tests.sender import SteadyDrive, codec_for

CHOICES = {"loop.rate_hz": (100, 200, 500, 1000)}
"""Keys that have a list in place of bounds."""
BENCH = {"R_s": 0.28, "L_s": 3.465e-3, "psi_pm": 0.1989, "pole_pairs": 4, "J": 0.04, "B": 0.0,
         "k_p": 1.5, "I_rated": 25.0, "T_rated": 30.0}  # fmt: skip
SIGNALS = {"dbc": "x.dbc", "use": {"Ia": {"signal": "M.A"}, "Ib": {"signal": "M.B"}}}
BASE = {"drive": [{"node": 1, "signals": SIGNALS}, {"node": 2}], "motor": {"x": BENCH},
        "estimator": {"process_noise": [1e-4, 1e-4, 1e-5, 1e-6, 0.1]},
        "adhesion": {"false_alarms_per_1000_h": 100.0,
                     "fault_free": {"minutes": 9, "longest_ms": [20]}}}  # fmt: skip
Bounds = tuple[float, float, bool]
"""Lowest, highest, whole numbers only."""


def limits(metadata):
    found = [m.func for m in metadata if isinstance(m, AfterValidator)]
    out = [(w.low, w.high) for w in found if isinstance(w, Within)]
    low = [m.ge for m in metadata if isinstance(m, Ge | Interval) and m.ge is not None]
    low += [m.gt for m in metadata if isinstance(m, Gt | Interval) and m.gt is not None]
    high = [m.le for m in metadata if isinstance(m, Le | Interval) and m.le is not None]
    high += [m.lt for m in metadata if isinstance(m, Lt | Interval) and m.lt is not None]
    return out + list(zip(low, high, strict=False))


def numbers(kind, metadata, path):
    """Paths of all numbers below a type, with their bounds or None."""
    origin = get_origin(kind)
    if origin is Annotated:
        inner, *more = get_args(kind)
        yield from numbers(inner, (*metadata, *more), path)
    elif kind in (int, float):
        found = limits(metadata)
        yield path, (*found[0], kind is int) if found else None
    elif origin in (Union, types.UnionType):
        for arg in get_args(kind):
            yield from numbers(arg, metadata, path)
    elif origin is tuple:
        args = get_args(kind)
        if args[-1] is Ellipsis:
            yield from numbers(args[0], (), f"{path}.*")
        else:
            for k, arg in enumerate(args):
                yield from numbers(arg, (), f"{path}.{k}")
    elif origin is dict:
        yield from numbers(get_args(kind)[1], (), f"{path}.*")
    elif isinstance(kind, type) and issubclass(kind, BaseModel):
        for name, field in kind.model_fields.items():
            if not field.exclude:
                below = f"{path}.{name}" if path else name
                yield from numbers(field.annotation, tuple(field.metadata), below)


KEYS: dict[str, Any] = dict(numbers(Config, (), ""))
BOUNDED: dict[str, Bounds] = {path: found for path, found in KEYS.items() if found is not None}


def place(path):
    """Where a number of that path stands in `BASE`."""
    concrete = {"drive.*": "drive.0", "motor.*": "motor.x", "use.*": "use.Ia",
                "cycle_ms.*": "cycle_ms.M", "not_available.*": "not_available.0",
                "longest_ms.*": "longest_ms.0"}  # fmt: skip
    for pattern, one in concrete.items():
        path = path.replace(pattern, one)
    return [int(part) if part.isdigit() else part for part in path.split(".")]


def with_number(path, value):
    """`BASE` with one number set."""

    def changed(table, where):
        if not where:
            return value
        first, *rest = where
        if isinstance(first, int):
            rows = list(table or [None] * (first + 1))
            rows[first] = changed(rows[first], rest)
            return rows
        return {**(table or {}), first: changed((table or {}).get(first), rest)}

    return changed(BASE, place(path))


def refused(raw):
    """What is wrong with it; empty where it is good."""
    try:
        parse(raw)
    except ConfigError as error:
        return error.problems
    return []


OF_ANOTHER = ("motor.", "drive.", "adhesion.tolerance", "adhesion.reuse")
"""Whose numbers must go with others: a motor's, and those of one detector."""
TOGETHER = ("is used twice", "is too small", "does not fit I_rated", "a time constant of",
            "would speed up", "a friction of", "has no such key; leave it at 0")  # fmt: skip
"""What is said of numbers that are good alone, but not together."""


def test_the_base_is_good_and_every_number_has_bounds():
    assert parse(BASE).nodes == (1, 2)
    assert len(BOUNDED) > 30
    unbounded = {path for path, found in KEYS.items() if found is None}
    assert unbounded == set(CHOICES)


@pytest.mark.parametrize("path", BOUNDED)
def test_beyond_a_bound_is_one_line_with_the_key(path):
    low, high, whole = BOUNDED[path]
    key = ".".join(map(str, place(path)))
    step = max(1.0, abs(high) * 1e-9) if whole else 0.0
    beyond = [high + step if whole else high * 1.001 + 1e-9, 1e300 if not whole else 10**40]
    beyond += [low - step if whole else low - abs(low) * 1e-3 - 1e-12, -1e300]
    for value in beyond:
        number = math.floor(value) if whole and value < low else value
        [line] = refused(with_number(path, int(number) if whole else number))
        assert line.startswith(f"{key}: "), line
        assert "expected " in line
        assert len(line) < 200
        assert line.isprintable()


@pytest.mark.parametrize("path", BOUNDED)
def test_at_a_bound_a_number_is_taken_or_does_not_go_with_another(path):
    """The bounds themselves are allowed; a motor's numbers must go together as well."""
    low, high, whole = BOUNDED[path]
    for value in (low, high):
        lines = refused(with_number(path, int(value) if whole else value))
        assert not lines or path.startswith(OF_ANOTHER), lines
        assert all(any(text in line for text in TOGETHER) for line in lines), lines


@pytest.mark.parametrize(("path", "allowed"), CHOICES.items())
def test_a_choice_is_one_line(path, allowed):
    for value in (0, -1, 10**40, max(allowed) + 1):
        [line] = refused(with_number(path, value))
        assert line.startswith(f"{path}: expected 100, 200, 500 or 1000 Hz")


def between(path):
    """Anything allowed, small and large numbers alike."""
    low, high, whole = BOUNDED[path]
    if whole:
        return st.integers(math.ceil(low), math.floor(high))
    if low <= 0.0:
        return st.floats(low, high)
    return st.floats(math.log(low), math.log(high)).map(lambda x: min(max(math.exp(x), low), high))


@st.composite
def configurations(draw):
    """Within bounds, the motors' numbers of machines that there could be."""

    def some(*paths):
        chosen = draw(st.sets(st.sampled_from(paths)))
        return {path.split(".")[-1]: draw(between(path)) for path in sorted(chosen)}

    under = {
        section: tuple(p for p in BOUNDED if p.startswith(f"{section}.") and p.count(".") == 1)
        for section in ("estimator", "adhesion", "thermal")
    }
    motor = {key: draw(between(f"motor.*.{key}")) for key in ("R_s", "psi_pm", "I_rated")}
    motor["pole_pairs"] = draw(between("motor.*.pole_pairs"))
    motor["L_s"] = motor["R_s"] * draw(st.floats(1e-3, 0.1))
    torque = 1.5 * motor["pole_pairs"] * motor["psi_pm"] * motor["I_rated"]
    motor["T_rated"] = torque * draw(st.floats(0.5, 2.0))
    motor["J"] = motor["T_rated"] / draw(st.floats(10.0, 1e4))
    noise = [draw(between(f"estimator.process_noise.{k}")) for k in range(5)]
    stated = {
        "fault_free": {
            "minutes": draw(between("adhesion.fault_free.minutes")),
            "longest_ms": [draw(between("adhesion.fault_free.longest_ms.*"))],
        }
    }
    fd = draw(st.booleans())
    detector = draw(st.sampled_from(["switching", "vb", "median", "kmeans", "paper_vb"]))
    adhesion = some(*(path for path in under["adhesion"]
                      if detector == "paper_vb" or path not in OF_ANOTHER))  # fmt: skip
    return {
        "dbc": {"file": "traction_fd.dbc" if fd else "traction.dbc"},
        "loop": {"rate_hz": draw(st.sampled_from(CHOICES["loop.rate_hz"]))},
        "drive": [{"node": n, "motor": draw(st.sampled_from(["x", "bench", "traction_350kw"]))}
                  for n in range(1, draw(st.integers(1, 3)) + 1)],
        "motor": {"x": motor},
        "estimator": {**some(*under["estimator"]),
                      **({"process_noise": noise} if draw(st.booleans()) else {})},
        "adhesion": {**adhesion, "detector": detector,
                     **(stated if "false_alarms_per_1000_h" in adhesion else {})},
        "thermal": some(*under["thermal"]),
    }  # fmt: skip


CODECS = {name: codec_for((1, 2, 3), bind_path) for name, bind_path in (
    ("traction.dbc", parse({}).dbc_path),
    ("traction_fd.dbc", parse({"dbc": {"file": "traction_fd.dbc"}}).dbc_path))}  # fmt: skip
SENT = [frame for k in range(25) for n in (1, 2, 3)
        for frame in SteadyDrive(CODECS["traction.dbc"], n, 80.0 * n, 15.0).frames(k)]  # fmt: skip


def accepted(raw):
    """None where the numbers do not go together, which is said in lines."""
    lines = refused(raw)
    assert all(line.startswith("motor.x.") for line in lines), lines
    return None if lines else parse(raw)


@settings(max_examples=examples(60))
@given(configurations())
def test_a_gateway_runs_with_whatever_is_within_bounds(raw):
    config = accepted(raw)
    assume(config is not None)
    gateway = Gateway(config, CODECS[config.dbc.file], 0)
    period = config.loop.period_ns
    for now in range(period, 50_000_000 + period, period):
        gateway.step([f for f in SENT if now - period < f.t_ns <= now], now)
    assert gateway.view is not None


@settings(max_examples=examples(4))
@given(configurations())
def test_a_synthetic_loss_is_found_or_its_cause_is_named(raw):
    config = accepted(raw)
    assume(config is not None)
    quick = config.adhesion.model_copy(update={"good_ms": config.adhesion.good_ms % 100})
    config = config.model_copy(update={"adhesion": quick})
    found = list(losses(config, bind(config.dbc_path, config.nodes)))
    assert {one.node for one in found} <= set(config.nodes)
    assert found
    for one in found:
        if one.after_ms is None:
            assert len(one.problem) > 40
            assert len(one.problem.splitlines()) == 1
        else:
            assert 0 < one.after_ms <= 1000

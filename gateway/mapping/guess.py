"""Guess which signals of another maker's DBC may be mapped to ours, by their names and units.

A person has to check each guess: a name shows what somebody called a signal, not what it is.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple
from unicodedata import normalize

from dbc.spec import MessageSpec, SignalSpec
from gateway.settings.signal_map import CURRENTS, UNITS, VOLTAGES

_WORDS: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_UNIT: Final = re.compile(r"[^a-z0-9/%*]")
_TENTHS: Final = re.compile(r"(.*[^\d\W])\s*/\s*(10+)|(0?\.0*1)\s*\*?\s*(\D.*)")
"""Unit with a factor: `A/10`, `0.1 A`."""
_CONVERSIONS: Final[dict[str, dict[str, tuple[float, float]]]] = {
    "A": {"a": (1, 0), "amp": (1, 0), "amps": (1, 0), "ampere": (1, 0), "ma": (1e-3, 0),
          "apk": (1, 0), "arms": (1.4142, 0)},
    "V": {"v": (1, 0), "volt": (1, 0), "volts": (1, 0), "mv": (1e-3, 0), "vrms": (1.4142, 0)},
    "rpm": {"rpm": (1, 0), "erpm": (1, 0), "1/min": (1, 0), "min1": (1, 0), "u/min": (1, 0),
            "r/min": (1, 0), "rad/s": (9.5493, 0), "rads/s": (9.5493, 0), "rps": (60, 0),
            "rev/s": (60, 0)},
    "Nm": {"nm": (1, 0), "n*m": (1, 0), "mnm": (1e-3, 0), "knm": (1e3, 0)},
    "degC": {"c": (1, 0), "degc": (1, 0), "celsius": (1, 0), "k": (1, -273.15),
             "f": (0.55556, -17.778), "degf": (0.55556, -17.778)},
    "deg": {"deg": (1, 0), "degree": (1, 0), "degrees": (1, 0), "rad": (57.2958, 0)},
}  # fmt: skip
"""By our unit: (scale, offset) from other units, written without blanks, points and signs."""
_MOMENTARY: Final = frozenset({"Ia", "Ib", "Ic", "Ialpha", "Ibeta", "Ualpha", "Ubeta"})
"""Quantities that alternate, so that a root mean square does not give them."""
_TARGET: Final = (
    r"tgt|rq|cmd|command|commanded|target|desired|des|request|requested|req|setpoint|set|ref|demand"
)
_NEVER: Final = (
    r"mx|mn|whl|limit|lim|max|min|maximum|minimum|available|avail|capability|error|err|enable|enabled|mode|"
    r"dc|bus|batt?|battery|lv|aux|charge|charger|charging|wheel|vehicle|gps|steer|steering|brake|"
    r"braking|driver|pedal|valid|qf|status|state|accuracy|warning|warn|fault|hist|avg|ff|crc|"
    r"checksum|shudder|gear|fan|pump|seat|cruise|hv|lipo|bms|cell|pdu|ui|diag|front|torsion|"
    r"blower|hvac|epb|chg|pcs|obc|config|cfg|param|lower|upper|threshold|"
    r"engine|eng|alternator|turbo|compressor|sas|eps|blade|articulation|insd|inside|cabin|interior"
)


_TEMPERATURE: Final = r"(temp|temps|temperature|temperatures)"


class Rule(NamedTuple):
    """How a quantity is recognised.

    Patterns of words in the name: required words, words that raise the score, and words that rule
    the signal out.
    """

    needs: str
    likely: str = r"motor|mot|inv|inverter"
    never: str = f"{_NEVER}|{_TARGET}"


def _phase(letter: str, others: str) -> Rule:
    return Rule(
        rf"\bi ?{letter}\b|\b(phase|ph) ?{letter}\b|\bcurrent ?{letter}\b|\bi ?{others}\b|"
        rf"\b(phase|ph) ?{others}\b|\bi? ?phase ?{letter}\b",
        r"current|curr|phase",
    )


RULES: Final[dict[str, Rule]] = {
    "Ia": _phase("a", "[u1]"),
    "Ib": _phase("b", "[v2]"),
    "Ic": _phase("c", "[w3]"),
    "Ialpha": Rule(r"\bi ?alpha\b|\balpha current\b|\bcurrent alpha\b"),
    "Ibeta": Rule(r"\bi ?beta\b|\bbeta current\b|\bcurrent beta\b"),
    "Id": Rule(r"\bi ?d\b|\bd (axis )?current\b|\bcurrent d\b", r"actual|act|feedback|fb|meas"),
    "Iq": Rule(r"\bi ?q\b|\bq (axis )?current\b|\bcurrent q\b",
               r"actual|act|feedback|fb|meas|measured"),
    "ElectricalAngle": Rule(r"\bangle\b|\btheta\b|\b(rotor|motor) position\b",
                            r"electrical|elec|el|rotor|motor"),
    "Ualpha": Rule(r"\b[uv] ?alpha\b|\balpha voltage\b|\bvoltage alpha\b"),
    "Ubeta": Rule(r"\b[uv] ?beta\b|\bbeta voltage\b|\bvoltage beta\b"),
    "Ud": Rule(r"\b[uv] ?d\b|\bd (axis )?voltage\b|\bvoltage d\b", r"actual|act|voltage"),
    "Uq": Rule(r"\b[uv] ?q\b|\bq (axis )?voltage\b|\bvoltage q\b", r"actual|act|voltage"),
    "Speed": Rule(r"\bspeed\b|\be?rpm\b|\bvelocity\b|\bvel\b|\bomega\b|\bn act\b",
                  r"motor|mot|mg|rotor|actual|act|feedback|fb|signed"),
    "Torque": Rule(r"\btorque\b|\btrq\b|\bmoment\b",
                   r"feedback|fb|actual|act|motor|mot|mg|effective|estimate|estimated|meas"),
    "TorqueCommand": Rule(rf"\b(torque|trq)\b.*\b({_TARGET})\b|\b({_TARGET})\b.*\b(torque|trq)\b",
                          r"motor|mot|mg|commanded|inv|inverter", _NEVER),
    "Irms": Rule(r"\b(rms|motor|phase) current\b|\bi ?rms\b|\bcurrent rms\b|\bmotor curr\b",
                 r"rms|actual|act"),
    "Tstator": Rule(rf"\b(motor|mot|stator|winding|mg)\b.*\b{_TEMPERATURE}\b|\bt (motor|stator)\b|"
                    rf"\b{_TEMPERATURE}\b.*\b(motor|mot|stator|winding)\b",
                    r"stator|winding",
                    rf"{_NEVER}|igbt|coolant|oil|board|gate|module|ambient|driver|bearing|de|nde"),
    "Tde": Rule(rf"\b({_TEMPERATURE}|t)\b.*\b(de|drive end)\b|"
                rf"\b(de|drive end)\b.*\b({_TEMPERATURE}|bearing)\b", r"bearing|motor",
                rf"{_NEVER}|non|nde"),
    "Tnde": Rule(rf"\b({_TEMPERATURE}|t)\b.*\b(nde|non drive end)\b|"
                 rf"\b(nde|non drive end)\b.*\b({_TEMPERATURE}|bearing)\b", r"bearing|motor"),
    "Tambient": Rule(rf"\b(ambient|outside|air)\b.*\b{_TEMPERATURE}\b|\bt (amb|ambient|air)\b|"
                     rf"\b{_TEMPERATURE}\b.*\b(ambient|outside)\b", r"ambient|outside"),
}  # fmt: skip
UNITLESS: Final = 0.6
"""Score of a signal for which the file has no unit; a unit that fits adds to it."""
_ELECTRICAL: Final = re.compile(r"\be ?rpm\b|\b(electrical|elec) (rpm|speed|velocity)\b")
_PAIRS: Final = 4
"""Pole pairs of the bench motor, until a person writes those of the own one."""
SURE: Final = 0.9
"""From this score on, both name and unit fit."""
_FORMS: Final = (("Ia", "Ib", "Ic"), *CURRENTS)


class Guess(NamedTuple):
    """One signal for one of our quantities; score 1 and more: both name and unit fit."""

    quantity: str
    message: MessageSpec
    signal: SignalSpec
    scale: float
    offset: float
    score: float

    @property
    def name(self) -> str:
        """Message.Signal, as in `[drive.signals.use]`."""
        return f"{self.message.name}.{self.signal.name}"

    @property
    def electrical(self) -> bool:
        """Whether it is a speed times pole pairs (ERPM)."""
        text = words(f"{self.signal.name} {self.signal.unit}")
        return self.quantity == "Speed" and bool(_ELECTRICAL.search(text))

    @property
    def sure(self) -> bool:
        """Whether it is used; a less likely one is written as a comment."""
        return self.score >= SURE - 1e-9


def words(name: str) -> str:
    """Split a name into words: `INV_MotorSpeed2` becomes `inv motor speed 2`."""
    return " ".join(_WORDS.findall(name)).lower()


def of_this_project(specs: Sequence[MessageSpec]) -> list[int]:
    """Nodes of drives that speak our own message set."""
    return sorted({spec.node for spec in specs if spec.kind == "PhaseCurrents" and spec.node})


def candidates(specs: Sequence[MessageSpec]) -> dict[str, list[Guess]]:
    """Guesses by quantity, the likeliest first; if equally likely, the one with a shorter cycle."""
    found: dict[str, list[Guess]] = {name: [] for name in RULES}
    for spec in specs:
        for signal in spec.signals:
            for guess in _of_signal(spec, signal):
                found[guess.quantity].append(guess)
    for guesses in found.values():
        guesses.sort(key=lambda g: (-g.score, g.message.cycle_ns or 10**12, g.name))
    return found


def _of_signal(spec: MessageSpec, signal: SignalSpec) -> Iterator[Guess]:
    if any(signal.name == other.mux_parent for other in spec.signals):
        return
    own, all_words = words(signal.name), words(f"{spec.name} {signal.name}")
    for quantity, rule in RULES.items():
        named = re.search(rule.needs, own)
        if signal.length < 6 or not (named or re.search(rule.needs, all_words)):
            continue
        if re.search(rf"\b({rule.never})\b", own):
            continue
        converted = conversion(quantity, signal.unit)
        if converted is None:
            continue
        score = UNITLESS + (0.4 if signal.unit.strip() else 0.0)
        score += 0.1 * min(len(set(re.findall(rf"\b({rule.likely})\b", all_words))), 3)
        score -= 0.3 * bool(re.search(rf"\b({rule.never})\b", all_words))
        score -= 0.1 * (named is None)
        if quantity == "ElectricalAngle" and not re.search(rf"\b({rule.likely})\b", all_words):
            score -= 0.2
        guess = Guess(quantity, spec, signal, *converted, score)
        if guess.electrical:  # the file does not have the pole pairs
            guess = guess._replace(scale=guess.scale / _PAIRS, score=min(score, UNITLESS))
        yield guess


def conversion(quantity: str, unit: str) -> tuple[float, float] | None:
    """Scale and offset from a unit to ours; None if the unit is that of another quantity."""
    ours = UNITS[quantity]
    unit = normalize("NFKC", unit)  # one character for degrees Celsius, as in Chinese files
    if tenths := _TENTHS.fullmatch(unit.strip()):
        whole = conversion(quantity, tenths[1] or tenths[4])
        factor = 1 / int(tenths[2]) if tenths[2] else float(tenths[3])
        return whole and (round(whole[0] * factor, 9), whole[1])
    plain = _UNIT.sub("", unit.lower().rpartition(":")[2].replace("°", "deg"))
    if not unit.strip() or (quantity == "Irms" and plain == "arms"):
        return 1.0, 0.0
    if quantity in _MOMENTARY and plain.endswith("rms"):
        return None
    return _CONVERSIONS[ours].get(plain)


def chosen(found: dict[str, list[Guess]]) -> list[Guess]:
    """One signal for each quantity that has a guess: complete forms only, no signal twice."""
    currents = _form(found, _FORMS) or [guess for guess in found["Iq"][:1] if guess.sure]
    out = [*currents, *_form(found, VOLTAGES)]
    used = {guess.name for guess in out}
    near = list(out)
    for quantity in ("ElectricalAngle", "Speed", "Torque", "TorqueCommand", "Irms", "Tstator",
                     "Tde", "Tnde", "Tambient"):  # fmt: skip
        left = [guess for guess in found[quantity] if guess.name not in used]
        left = [g for g in left if left and g.score >= left[0].score - 1e-9]
        if left:
            # Messages of another drive differ in a word from those that are already used.
            best = max(left, key=lambda guess: _likeness(guess, near))
            out.append(best)
            if best.sure:
                used.add(best.name)
                near.append(best)
    names = {guess.quantity for guess in out}
    if "ElectricalAngle" not in names:
        out = [guess for guess in out if guess.quantity not in ("Ud", "Uq")]
    order = list(RULES)
    return sorted(out, key=lambda guess: order.index(guess.quantity))


def _likeness(guess: Guess, near: Sequence[Guess]) -> int:
    """Most words that the name of its message has in common with that of one of the others."""
    own = set(words(guess.message.name).split())
    return max((len(own & set(words(g.message.name).split())) for g in near), default=0)


def _form(found: dict[str, list[Guess]], forms: Sequence[tuple[str, ...]]) -> list[Guess]:
    """The first form whose parts are all in one message; empty if there is none."""
    for form in forms:
        for first in found[form[0]]:
            rest = [
                next((g for g in found[name] if g.message is first.message), None)
                for name in form[1:]
            ]
            if all(rest):
                return [first, *(guess for guess in rest if guess is not None)]
    return []


def layout(spec: MessageSpec) -> tuple[object, ...]:
    """Layout that two drives' messages of one kind share: bits, and names without their numbers."""
    return tuple((re.sub(r"\d+", "#", s.name), s.start, s.length) for s in spec.signals)


def step(used: Mapping[int, object], there: Mapping[int, object], drives: int) -> int | None:
    """Distance of the identifiers from one drive to the next; None if it cannot be found.

    used, there: layouts of messages by identifier. used: of the first drive; there: all of a file,
    or of a log, which shows only which identifiers are there.
    """
    if drives < 2 or not used:
        return None
    first = min(used)
    for one in sorted(there):
        gap = one - first
        shifted = {i + gap * k: look for k in range(1, drives) for i, look in used.items()}
        alike = all(i in there and there[i] == look for i, look in shifted.items())
        if gap > 0 and alike and not shifted.keys() & used.keys():
            return gap
    return None

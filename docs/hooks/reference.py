"""Pages of the site that are made of the code: commands, keys, messages, the API, sources.

mkdocs calls `on_files` and `on_page_markdown`. The pages of `COMMITTED` are in the repository, for
its readers: `python docs/hooks/reference.py` writes them, a test compares them. All others are made
with the site, so they cannot be out of date.
"""

from __future__ import annotations

import argparse
import inspect
import os
import re
import tomllib
import types
import typing
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import cantools
from annotated_types import Ge, Gt, Le, Lt
from cantools.database import Signal
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from pydantic import AfterValidator, BaseModel
from pydantic.fields import FieldInfo

import dbc
from dbc.toml_files import Within
from gateway import api as gateway_api
from gateway import cli
from gateway.settings import config
from sim import scenario, scenarios
from sim.scenario_schema import Curve, Disturbance
from sim.scenario_schema import Strict as SimStrict

ROOT = Path(__file__).parents[2]
COMMITTED = ("scenarios", "configuration", "messages")
"""Pages in docs/reference that other pages refer to."""
PUBLIC: dict[str, tuple[str, ...]] = {
    "replay": (),
    "scenario": (),
    "Run": ("flags", "estimates", "events", "known", "frames", "to_pandas", "report"),
    "Scenario": ("run",),
    "Judged": ("verdicts", "passed"),
    "Config": (),
    "InputError": (),
    "ConfigError": ("problems",),
    "Gateway": ("step",),
    "detectors": (),
    "Evidence": (),
    "Opinion": (),
}
"""Names of the Python API, with those members of a class that are public."""
BUILT = ("Run", "Judged", "Config")
"""Classes that only we make an object of, or whose arguments are the keys of a file."""
MEANINGS = tomllib.loads(Path(__file__).with_name("meanings.toml").read_text(encoding="utf-8"))
SIGNS = {Gt: ">", Ge: ">=", Lt: "<", Le: "<="}
BOUNDS = {Gt: "gt", Ge: "ge", Lt: "lt", Le: "le"}
NUMBERED = "Drive1_"
_NUMBERED = re.compile("(Adhesion|Thermal)([2-9]|1[0-6])")
"""Of sixteen alike drives and flags the first stands for all."""
LINE = re.compile(r"\[`(\w+)`\]\(\.\./([\w./]+\.(c|py))#L(\d+)\)")
"""A link of a page in docs/ to a line of the code."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what is generated."""
    for name, text in pages().items():
        if name in COMMITTED:
            continue
        files.append(File.generated(config, f"reference/{name}.md", content=text))
    for path in sorted({found[1] for found in LINE.findall(_all_pages())}):
        files.append(File.generated(config, f"source/{path}.md", content=source(path)))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Links to lines of the code lead to pages of the site; in the repository, to the files."""
    if "/" in page.file.src_uri:
        return markdown
    anchor = r'<a href="source/\2.html#__codelineno-0-\4"><code>\1</code></a>'
    return LINE.sub(anchor, markdown)


def _all_pages() -> str:
    return "".join(path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md"))


def source(path: str) -> str:
    """A file of the code, its lines numbered."""
    language = "python" if path.endswith(".py") else "c"
    text = (ROOT / path).read_text(encoding="utf-8").rstrip()
    head = f"---\nsearch:\n  exclude: true\n---\n\n# {path}\n"
    return f'{head}\n````{language} linenums="1"\n{text}\n````\n'


def pages() -> dict[str, str]:
    """Markdown of every generated page by name."""
    os.environ["COLUMNS"] = "96"
    return {
        "commands": commands(),
        "configuration": configuration(),
        "scenarios": scenario_page(),
        "messages": messages("traction.dbc"),
        "messages_fd": messages("traction_fd.dbc"),
        "api": api(),
    }


def commands() -> str:
    """What `--help` says of every verb."""
    out = [
        "# Commands",
        "",
        "[Exit codes](../codes.md#exit-codes) are the same for all verbs.",
        "",
    ]
    for verb in cli.VERBS:
        out += [f"## {verb}", "", "```text", _help(verb).rstrip(), "```", ""]
    return "\n".join(out)


def _help(verb: str) -> str:
    parser = cli._parser([verb])
    verbs = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    return str(verbs.choices[verb].format_help())


def configuration() -> str:
    """Every key of the configuration, and the commented example."""
    example = (ROOT / "examples" / "train.toml").read_text(encoding="utf-8")
    out = [
        "# Configuration", "",
        "TOML, read once and validated as a whole: every problem is listed with its path, and "
        "unknown keys are refused. All of it with comments, as it ships in `examples/train.toml`:",
        "",
        "```toml", example.rstrip(), "```", "",
    ]  # fmt: skip
    sections = {
        "bus": config.Bus, "loop": config.Loop, "dbc": config.Dbc, "drive": config.Drive,
        "motor.NAME": config.Motor, "estimator": config.Estimator, "adhesion": config.Adhesion,
        "thermal": config.Thermal, "canopen": config.Canopen,
        "authentication": config.Authentication,
    }  # fmt: skip
    for name, model in sections.items():
        out += [f"## [{name}]", "", _about(model), "", *_table(model, "configuration", name), ""]
    return "\n".join(out)


def scenario_page() -> str:
    """Keys of scenario files, and the scenarios that ship."""
    out = [
        "# Scenarios",
        "",
        "One TOML file is a simulated run, a test on the virtual clock and a test on a real bus.",
        "The [tutorial](../tutorials/hil_tests.md) has an example. Required are `title`,",
        "`duration_s` and, for a test, an `[[expect]]`. `drive` is a node number everywhere.",
        "",
    ]
    out += ["## Top level", "", *_table(scenario.Scenario, "scenario", "top"), ""]
    for name, part in (("event", scenario.Event), ("expect", scenario.Expect)):
        out += [f"## [[{name}]]", "", _about(part), "", *_table(part, "scenario", name), ""]
    for name, field in scenario.Scenario.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, SimStrict):
            out += [f"## [{name}]", "", _about(kind), "", *_table(kind, "scenario", name), ""]
        if name == "load":
            for key, part in (("disturbance", Disturbance), ("curve", Curve)):
                rows = _table(part, "scenario", f"load.{key}")
                out += [f"## [[load.{key}]]", "", _about(part), "", *rows, ""]
    out += ["## Shipped", "", "| name | title |", "|---|---|"]
    for path in sorted(Path(scenarios.__path__[0]).glob("*.toml")):
        title = scenario.load(str(path)).title
        out.append(f"| `{path.stem}` | {title} |")
    return "\n".join([*out, ""])


def _about(model: type[BaseModel]) -> str:
    return inspect.getdoc(model) or ""


@cache
def comments() -> dict[str, dict[str, str]]:
    """Comments of the keys of `examples/train.toml`, by section; of commented-out keys, too."""
    out: dict[str, dict[str, str]] = {}
    section: dict[str, str] = {}
    key = ""
    for line in (ROOT / "examples" / "train.toml").read_text(encoding="utf-8").splitlines():
        if header := re.match(r"(?:# )?\[\[?([\w.]+)\]", line):
            section, key = out.setdefault(header[1].replace(".bench", ".NAME"), {}), ""
        elif found := re.match(r"(?:# )?(\w+) = .*?  ?# (.*)", line):
            key = found[1]
            section.setdefault(key, found[2])
        elif key and (more := re.match(r" +# (.*)", line)):
            section[key] += " " + more[1]
    return out


def _table(model: type[BaseModel], page: str, section: str) -> list[str]:
    """Raises LookupError for a key without a meaning, and for a meaning without its key."""
    rows = ["| key | type | default | meaning |", "|---|---|---|---|"]
    told = dict((comments() if page == "configuration" else MEANINGS[page]).get(section, {}))
    for name, field in model.model_fields.items():
        if field.exclude:
            continue
        key = field.alias or name
        meaning = field.description or told.pop(key)
        cells = (f"`{key}`", _type(field), _default(field), meaning)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    if told:
        raise LookupError(f"[{section}] has no {', '.join(told)}")
    return rows


def _type(field: FieldInfo) -> str:
    return f"`{_words(field.annotation)}{_limits(field.metadata)}`"


def _words(kind: typing.Any) -> str:
    """A type as a person writes it."""
    origin, args = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Annotated:
        return _words(args[0]) + _limits(_rules(args[1:]))
    if origin is typing.Literal:
        return " or ".join(f'"{value}"' for value in args)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(_words(part) for part in args if part is not types.NoneType)
    if origin is tuple and len(set(args)) == 1:
        return f"{len(args)} x {_words(args[0])}"
    if origin in (list, tuple):
        parts = " , ".join(_words(part) for part in args if part is not ...)
        return f"list of {parts}" if origin is list or ... in args else f"({parts})"
    if not isinstance(kind, type):
        return str(kind)
    return "table" if issubclass(kind, BaseModel) else kind.__name__


def _rules(metadata: Iterable[typing.Any]) -> Iterator[typing.Any]:
    for rule in metadata:
        yield from rule.metadata if isinstance(rule, FieldInfo) else (rule,)


def _limits(metadata: Iterable[typing.Any]) -> str:
    shown = []
    for rule in metadata:
        if type(rule) in SIGNS:
            shown.append(f" {SIGNS[type(rule)]} {getattr(rule, BOUNDS[type(rule)])}")
        elif isinstance(rule, AfterValidator) and isinstance(rule.func, Within):
            shown.append(f" {rule.func}")
    return ",".join(shown)


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True, validated_data={"drives": 3})
    return "defaults" if isinstance(value, BaseModel) else f"`{value!r}`"


def messages(name: str) -> str:
    """The message set as cantools reads it."""
    bus = cantools.database.load_file(Path(dbc.__path__[0]) / name, strict=True)
    out = [
        f"# Message set: {name}",
        "",
        "Generated from the DBC. n is the drive, 1 to 16; little endian.",
        "",
    ]
    for message in sorted(bus.messages, key=lambda m: (not m.name.startswith("Gateway"), m.name)):
        if message.name.startswith("Drive") and not message.name.startswith(NUMBERED):
            continue
        title = message.name.replace(NUMBERED, "Drive{n}_")
        base = message.frame_id - (1 if message.name.startswith(NUMBERED) else 0)
        where = f"0x{base:03X} + n" if message.name.startswith(NUMBERED) else f"0x{base:03X}"
        cycle = f", every {message.cycle_time} ms" if message.cycle_time else ""
        by = ", ".join(message.senders).replace("Drive1", "Drive{n}")
        out += [
            f"## {title}",
            "",
            f"`{where}`, {message.length} bytes, from {by}{cycle}. {message.comment or ''}",
            "",
        ]
        out += ["| signal | bits | value | unit | meaning |", "|---|---|---|---|---|"]
        out += [_signal(s) for s in message.signals if not _NUMBERED.fullmatch(s.name)]
        out.append("")
    return "\n".join(out)


def _signal(signal: Signal) -> str:
    name = f"`{signal.name}`"
    if signal.name in ("Adhesion1", "Thermal1"):
        name += f" .. `{signal.name}6`, 2 bits each"
    bits = f"{signal.start}\\|{signal.length}{' signed' if signal.is_signed else ''}"
    value = "" if (signal.scale, signal.offset) == (1, 0) else f"x {signal.scale}"
    value += f" {signal.offset:+}" if signal.offset else ""
    if signal.minimum is not None:
        value += f" ({signal.minimum} .. {signal.maximum})"
    words = ", ".join(f"{int(k)} {v}" for k, v in sorted((signal.choices or {}).items()))
    meaning = " ".join(part for part in (signal.comment, words) if part)
    return f"| {name} | {bits} | {value.strip()} | {signal.unit or ''} | {meaning} |"


def api() -> str:
    """A heading per public name; mkdocstrings fills in what its docstrings say."""
    out = ["# Python API", "", "These names are stable; all others are private.", ""]
    for name, found in public().items():
        shown = ", ".join(PUBLIC[name])
        options = ["    options:", f"      members: [{shown}]", f'      heading: "gateway.{name}"']
        out += [f"::: {_defined(name, found)}", *options, ""]
    return "\n".join(out)


def public() -> dict[str, typing.Any]:
    """Everything that `import gateway` and its results offer, by name."""
    return {name: getattr(gateway_api, name) for name in PUBLIC}


def _defined(name: str, found: typing.Any) -> str:
    where = getattr(found, "__module__", gateway_api.__name__)
    return f"{where}.{name}"


def signatures() -> str:
    """What a program relies on: a line for each public name, and for each member of a class."""
    lines = []
    for name, found in public().items():
        lines.append(f"{name}{_signature(found)}")
        lines += [f"{name}.{member}{_member(found, member)}" for member in PUBLIC[name]]
    return "\n".join([*lines, ""])


def _signature(found: typing.Any) -> str:
    if isinstance(found, tuple):
        return f" = {found!r}"
    if isinstance(found, type) and (found.__name__ in BUILT or issubclass(found, Exception)):
        return f"({', '.join(base.__name__ for base in found.__bases__)})"
    return str(inspect.signature(found))


def _member(found: type, name: str) -> str:
    member = inspect.getattr_static(found, name, None)
    if inspect.isfunction(member):
        return str(inspect.signature(member))
    get = getattr(member, "fget", getattr(member, "func", None))
    return f": {inspect.signature(get).return_annotation}" if get else ""


def main() -> None:
    """Write the pages that are committed."""
    made = pages()
    for name in COMMITTED:
        (ROOT / "docs" / "reference" / f"{name}.md").write_text(made[name], encoding="utf-8")


if __name__ == "__main__":
    main()

"""The report of a run, from a replay or a bench: configuration, flags, and their score.

One Markdown text for `report.md` and `report.html`. Nothing in it depends on the time or place of
writing: the same run gives the same bytes.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

from gateway.core.codes import REJECTED
from gateway.reports import page, words
from gateway.reports.intervals import Interval, Intervals
from gateway.reports.known import drives as of_drives
from gateway.reports.page import Anchors, code, folded, picture, plain, table
from gateway.reports.record import camel
from gateway.reports.scoring import Judged, judge
from gateway.reports.timing import Timed, section
from gateway.reports.trace import Trace
from gateway.reports.truth import Truth

if TYPE_CHECKING:
    from gateway.reports.expectations import Verdict

FEW: Final = 30
"""Most rows of a table that is not folded."""
STATES: Final = (
    ("adhesion", "Adhering"), ("adhesion", "AdhesionLost"), ("adhesion", "Unknown"),
    ("thermal", "NoFault"), ("thermal", "Fault"), ("thermal", "Unknown"),
)  # fmt: skip
NO_TIMING: Final = (
    "None: this ran on a virtual clock, which is never late. Latency is measured on a bus."
)


@dataclass
class Run:
    """Data of one run for its report.

    facts, configuration: rows of (name, value), Markdown; toml: the whole configuration; figures:
    stems, relative to the report: `flags`, then one for each drive; counts: those of the inbox.
    """

    title: str
    facts: Sequence[tuple[str, str]]
    configuration: Sequence[tuple[str, str]]
    toml: str
    trace: Trace
    intervals: Intervals
    counts: Mapping[str, int]
    truth: Truth | None = None
    verdicts: Sequence[Verdict] = ()
    timed: Timed | None = None
    figures: Sequence[str] = ()
    bus: str = ""
    notes: Sequence[str] = field(default_factory=tuple)
    """Sentences about the input, Markdown."""
    overload: str = ""
    """Why this machine was too slow for the run, so that no failure counts."""

    def judged(self) -> tuple[list[Judged], set[Interval]]:
        """Events with delays, and false flags, for the drives with a known truth."""
        if self.truth is None:
            return [], set()
        known = self.truth.nodes
        mine = [i for i in self.intervals.kept if i.node in known]
        nodes = self.trace.nodes
        events = [event for event in self.truth.events if event.node in nodes]
        mine = [i for i in mine if i.flag in ("adhesion", "thermal", "sensor")]
        return judge(events, mine, self.trace.first_ns or 0)


def leave(folder: Path, title: str, runs: Sequence[Run], program: str, *, single: bool) -> None:
    """Write `report.md` and `report.html`. single: the page shows only one run.

    Raises OSError.
    """
    lines = [f"# {plain(title)}", ""]
    lines += [f"> {line}" for line in (_verdict(runs[0]) if single else _all(runs))]
    lines += ["", f"Written by {plain(program)}.", ""]
    body: list[str] = []
    for run in runs:
        if not single:
            body += [f"## {plain(run.title)}", "", *(f"> {line}" for line in _verdict(run)), ""]
        body += _sections(run, "##" if single else "###")
    lines += _contents([title, *(line for line in body if line.startswith("#"))])
    text = "\n".join([*lines, *body, *_glossary(runs)])
    spans = {name: run.trace.span_s for run in runs for name in run.figures}
    figures = [*spans, *(run.timed.picture for run in runs if run.timed)]
    page.write(folder, title, _tight(text), figures, spans)


def _tight(text: str) -> str:
    """The text with at most one empty line in a row."""
    while "\n\n\n" in text:
        text = text.replace("\n\n\n", "\n\n")
    return text.rstrip("\n") + "\n"


def _contents(headings: Sequence[str]) -> list[str]:
    """Links to the sections of the page, in the order of the headings."""
    anchors = Anchors()
    anchors.anchor_of(headings[0])
    parts: list[list[str]] = []
    for heading in headings[1:]:
        level, _, words_ = heading.partition(" ")
        anchor = anchors.anchor_of(re.sub(r"\\(.)", r"\1", words_).replace("&amp;", "&"))
        link = f"[{words_}](#{anchor})"
        if level == "##":
            parts.append([link])
        elif words_.startswith("Drive "):
            parts[-1].append(link)
    if all(len(part) == 1 for part in parts):
        return [" · ".join(part[0] for part in parts), ""]
    return [*(f"- {' · '.join(part)}" for part in parts), ""]


def _plural(count: int, one: str, many: str = "") -> str:
    return f"{count:,} {one if count == 1 else many or one + 's'}"


def _verdict(run: Run) -> list[str]:
    """The result of a run, for the top of its report."""
    lines = []
    if run.verdicts:
        bad = sum(not v.passed for v in run.verdicts)
        total = _plural(len(run.verdicts), "expectation")
        word = "Passed" if not bad else "Inconclusive" if run.overload else "FAILED"
        lines.append(f"**{word}: {len(run.verdicts) - bad} of {total} held.**")
        if run.overload:
            lines.append(f"This machine could not keep up: {run.overload}. Run it again.")
    summary = _summary(run.intervals)
    lines.append(summary if run.verdicts else f"**{summary}**")
    judged, false = run.judged()
    if run.truth is not None:
        found = [j for j in judged if j.delay_ms is not None]
        delays = sorted(j.delay_ms or 0.0 for j in found)
        cut = sum(j.event.cut and j.delay_ms is None for j in judged)
        events = _plural(len(judged) - cut, "event")
        text = f"Against the truth: {len(found)} of {events} found"
        if delays:
            middle = delays[(len(delays) - 1) // 2]
            text += f" (delay: median {middle:,.0f} ms, longest {delays[-1]:,.0f} ms)"
        if cut:
            text += f", {cut} without a flag where the drive cut its own torque"
        lines.append(f"{text}, {_plural(len(false), 'false flag')}.")
    return lines


def _summary(intervals: Intervals) -> str:
    """What was flagged, and the share of the time in which the flags were known."""
    other = sum(1 for _ in intervals.other_bad())
    parts = [
        _flagged(intervals, "adhesion", "Adhesion", "AdhesionLost", "loss", "losses"),
        _flagged(intervals, "thermal", "Thermal state", "Fault", "fault"),
    ]
    if other:
        parts.append(f"{_plural(other, 'other fault')} flagged.")
    return " ".join(parts)


def _flagged(
    intervals: Intervals, flag: str, name: str, state: str, one: str, many: str = ""
) -> str:
    seconds = dict(_seconds(intervals, flag))
    total = sum(seconds.values())
    known = total - seconds.get("Unknown", 0.0)
    if not known > 0.0:
        return f"{name} was never known: there is no result."
    count = sum(n for (_, f, s), n in intervals.count.items() if (f, s) == (flag, state))
    found = _plural(count, one, many) if count else f"no {one}"
    never = _never(intervals, flag)
    but = f", never{never}" if never else ""
    return f"{name}, known for {100.0 * known / total:.1f} % of the time{but}: {found} flagged."


def _never(intervals: Intervals, flag: str) -> str:
    """The drives whose flag was never known, as text; empty if there are none."""
    states: dict[int, set[str]] = {}
    for (node, f, state), spent in intervals.seconds.items():
        if f == flag and spent > 0.0:
            states.setdefault(node, set()).add(state)
    nodes = sorted(node for node, seen in states.items() if seen == {"Unknown"})
    return of_drives(nodes, len(states)) if nodes else ""


def _seconds(intervals: Intervals, flag: str) -> Iterable[tuple[str, float]]:
    """Seconds in each state, summed over all drives."""
    total: dict[str, float] = {}
    for (_, f, state), spent in intervals.seconds.items():
        if f == flag:
            total[state] = total.get(state, 0.0) + spent
    return total.items()


def _all(runs: Sequence[Run]) -> list[str]:
    """The result of several runs."""
    verdicts = [v for run in runs for v in run.verdicts]
    bad = sum(not v.passed for v in verdicts)
    failed = sum(any(not v.passed for v in run.verdicts) for run in runs)
    conclusive = any(not v.passed for run in runs if not run.overload for v in run.verdicts)
    word = "Passed" if not bad else "FAILED" if conclusive else "Inconclusive"
    return [
        f"**{word}: {len(runs) - failed} of {_plural(len(runs), 'scenario')}, "
        f"{len(verdicts) - bad} of {_plural(len(verdicts), 'expectation')} held.**"
    ]


def _sections(run: Run, level: str) -> list[str]:
    lines: list[str] = []
    if run.verdicts:
        lines += [f"{level} Expectations", *_expectations(run.verdicts)]
    lines += [f"{level} What was run", *table(("", ""), run.facts), *run.notes, ""]
    lines += [f"{level} Configuration", *table(("", ""), run.configuration)]
    lines += folded("The whole configuration, defaults included", code(run.toml, "toml"))
    lines += [f"{level} Flags", *_flags(run)]
    lines += [f"{level} Detections", *_detections(run)]
    for node, figure in zip(run.trace.nodes, run.figures[1:], strict=False):
        what = f"Load, loss probability, flags, speed and temperatures of drive {node} over time"
        lines += [f"{level} Drive {node}", *picture(what, figure)]
    timing = section(run.timed) if run.timed else [NO_TIMING, ""]
    lines += [f"{level} Latency and lateness", "", *timing]
    lines += [f"{level} Frames and bus", *_frames(run)]
    return lines


def _expectations(verdicts: Sequence[Verdict]) -> list[str]:
    rows = [
        (
            "ok" if v.passed else "**FAILED**", plain(v.text),
            "" if v.delay_ms is None else f"{v.delay_ms:,.0f}",
            "" if v.limit_ms is None else f"{v.limit_ms:,.0f}",
            plain(v.detail),
        )
        for v in verdicts
    ]  # fmt: skip
    return table(("", "expected", "measured / ms:", "limit / ms:", "what was seen"), rows)


def _flags(run: Run) -> list[str]:
    what = "Flags of all drives as strips over time, and the bus load"
    lines = picture(what, run.figures[0]) if run.figures else []
    if run.trace.width > 1:
        lines += [
            f"Each point of a picture covers {run.trace.width} ticks: smallest and largest value "
            "and worst flag, so a single tick stays visible.", ""
        ]  # fmt: skip
    count, seconds = run.intervals.count, run.intervals.seconds
    rows = [
        (str(node), *(f"{seconds.get((node, *kind), 0.0):,.2f} ({count[node, *kind]:,})"
                      for kind in STATES))
        for node in run.trace.nodes
    ]  # fmt: skip
    names = (f"{flag} {state}" if state == "Unknown" else state for flag, state in STATES)
    head = ("drive:", *(f"{name}:" for name in names))
    return [*lines, "Seconds in each state, and how often:", *table(head, rows)]


def _detections(run: Run) -> list[str]:
    judged, false = run.judged()
    lines: list[str] = []
    if run.truth is None:
        lines += ["", "Without ground truth, missed events cannot be counted."]
    elif not judged:
        lines += ["", "In truth no adhesion was lost, and no motor or sensor had a thermal fault."]
    else:
        lines += ["", "True events and their flags (missed: no flag of the same kind before the "
                  "end; cut: the drive cut its own torque and the wheel never slid):",
                  *_events(judged)]  # fmt: skip
    start_ns = run.trace.first_ns or 0
    known = run.truth is not None
    mine = list(run.intervals.of_drives())
    bad = [i for i in mine if i.bad]
    if bad:
        lines += ["", "What was flagged:", *_intervals(bad, start_ns, judged, false, known=known)]
    else:
        lines += ["", "Nothing was flagged."]
    others = list(run.intervals.other_bad())
    if others:
        lines += ["", "Other faults (sensors, communication, estimators, the train):",
                  *_intervals(others, start_ns, judged, false, known=known)]  # fmt: skip
    every = _intervals(mine, start_ns, judged, false, known=known)
    for (flag, state), n in run.intervals.left_out().items():
        every += [f"{n:,} more intervals of {flag} {state} are in flags.csv only.", ""]
    summary = f"All {len(mine):,} intervals of the adhesion and thermal flags"
    return [*lines, *(folded(summary, every) if len(mine) > FEW else ["", f"{summary}:", *every])]


def _events(judged: Sequence[Judged]) -> list[str]:
    rows = [
        (
            str(j.event.node), j.event.flag, j.event.kind + ", cut" * j.event.cut,
            f"{j.event.start_s:,.3f}", f"{j.event.end_s:,.3f}",
            f"{j.delay_ms:,.0f}" if j.delay_ms is not None else "cut" if j.event.cut
            else "**missed**",
            ", ".join(j.by.causes) if j.by else "",
        )
        for j in judged
    ]  # fmt: skip
    return table(
        ("drive", "flag", "truth", "from / s:", "to / s:", "delay / ms:", "named as"), rows
    )


def _intervals(
    intervals: Iterable[Interval],
    start_ns: int,
    judged: Sequence[Judged],
    false: set[Interval],
    *,
    known: bool,
) -> list[str]:
    """Table of intervals; known: with a column for the truth of each."""
    rows = []
    for i in intervals:
        begin, end = (i.start_ns - start_ns) / 1e9, (i.end_ns - start_ns) / 1e9
        row = [
            str(i.node) if i.node else "all", i.flag, i.state, f"{begin:,.3f}", f"{end:,.3f}",
            f"{(i.end_ns - i.start_ns) / 1e9:,.3f}", ", ".join(i.causes),
        ]  # fmt: skip
        if known:
            row.append(_truth_of(i, judged, false))
        rows.append(row)
    head = ("drive", "flag", "state", "from / s:", "to / s:", "lasted / s:", "why")
    return table((*head, "truth") if known else head, rows)


def _truth_of(i: Interval, judged: Sequence[Judged], false: set[Interval]) -> str:
    if i in false:
        return "**false**"
    mine = [j for j in judged if j.by == i]
    return ", ".join(f"{j.event.kind}, {j.delay_ms:,.0f} ms after its start" for j in mine)


def _frames(run: Run) -> list[str]:
    counts = run.counts
    used = [name for name in words.COUNTS if name not in words.NOT_USED and counts.get(name)]
    lines = table(
        ("frames", "count:", "meaning"),
        ((name, f"{counts[name]:,}", words.COUNTS[name]) for name in used),
    )
    wrong = [name for name in words.NOT_USED if counts.get(name)]
    if wrong:
        rejected = sum(counts.get(name, 0) for name in REJECTED)
        lines += [
            f"Not used, by cause; {rejected:,} of them are the bus's `RejectedFrames`:",
            *table(("cause", "count:", "meaning"),
                   ((name, f"{counts[name]:,}", words.COUNTS[name]) for name in wrong)),
        ]  # fmt: skip
    else:
        lines += ["No frame was rejected, none was lost.", ""]
    load = run.trace.bus_load
    if load is None:
        lines += ["Bus load: not known, the run was shorter than one second."]
    else:
        least, mean, most = load
        lines += [
            f"Bus load {run.bus}, worst-case stuffing, per second: mean {mean:.0f} %, "
            f"min {least:.0f} %, max {most:.0f} %. Own frames are counted as they were sent."
        ]
    return [*lines, ""]


def _glossary(runs: Sequence[Run]) -> list[str]:
    """Explanation of the report, with the reasons that occurred."""
    seen = {cause for run in runs for i in run.intervals.kept for cause in i.causes}
    rows = [(camel(r.name), text) for r, text in words.REASONS.items() if camel(r.name) in seen]
    summary = "Seconds count from the first tick. An interval ends when the flag changes"
    lines = ["## How to read this", "", f"{summary}, the last one with the run."]
    if not rows:
        return lines
    return [
        *lines,
        "Each `Unknown` has a reason; `traction-gateway explain REASON` explains what to do:",
        *table(("reason", "meaning"), rows),
    ]

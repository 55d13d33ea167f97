"""Metrics: the text parses, names keep the conventions, nothing unknown has a number."""

import json
import math
import re
from pathlib import Path

import pytest
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.parser import text_string_to_metric_families

from gateway.core.codes import Flag, Health
from gateway.monitor.feed import Feed
from gateway.monitor.model.metrics import PREFIX, FeedCollector
from gateway.monitor.model.snapshot import DriveRow, GatewayRow, Lateness, LinkRow
from tests.watched import EMPTY, FULL, FakeSource, snapshot

EXAMPLES = Path(__file__).parents[2] / "examples"


def text_of(**changes):
    feed = Feed(FakeSource(make=lambda t_s: snapshot(t_s, **changes)))
    feed.counts["slow"] = 2
    feed.happened["error"] = 3
    feed.look()
    registry = CollectorRegistry(auto_describe=False)
    registry.register(FeedCollector(feed))
    return generate_latest(registry).decode()


def parsed(text):
    """(name, labels) -> value; no sample comes twice."""
    found = {}
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            key = (sample.name.removeprefix(PREFIX), tuple(sorted(sample.labels.items())))
            assert key not in found, key
            found[key] = sample.value
    return found


def value(found, name, **labels):
    return found.get((name, tuple(sorted(labels.items()))))


def test_everything_of_a_drive():
    found = parsed(text_of())

    def of(name, **labels):
        return value(found, f"drive_{name}", drive="1", **labels)

    assert of("adhesion") == Flag.GOOD == 1
    assert of("thermal") == Flag.BAD == 2
    assert of("health", health="Tracking") == 1
    assert of("health", health="Diverged") == 0
    assert of("speed_radians_per_second") == FULL.speed_rad_s
    assert of("measured_speed_radians_per_second") == FULL.measured_speed_rad_s
    assert of("load_torque_newton_meters") == FULL.load_nm
    assert of("load_torque_sigma_newton_meters") == FULL.load_sigma_nm
    assert of("loss_probability_ratio") == FULL.loss_probability
    assert of("nis") == FULL.nis
    assert of("maisd_kelvin") == FULL.maisd_k
    assert of("temperature_jumps") == FULL.jumps
    assert of("degradation_kelvin_per_hour") == FULL.degradation_k_h
    assert of("last_frame_age_seconds") == FULL.age_s
    points = {
        "stator": 87.2,
        "drive_end": 47.9,
        "non_drive_end": 47.6,
        "ambient": 20.2,
        "mixed": 60.7,
    }
    assert {p: of("temperature_celsius", point=p) for p in points} == points
    assert of("fault_class", fault_class="Bearing") == 1
    assert of("state", state="Operation") == 1
    assert of("heartbeat", heartbeat="Operational") == 1
    assert of("heartbeat", heartbeat="Silent") == 0
    assert of("rejected_frames_total") == FULL.rejected


def test_everything_of_the_gateway_and_the_bus():
    found = parsed(text_of())
    about = value(found, "info", config_hash="3ba3f4", detector="Median", source="bus")
    assert about == 1
    for flag, number in (("common_mode", 1), ("sensor_fault", 2), ("comm_fault", 0)):
        assert value(found, "flag", flag=flag) == number
    assert value(found, "state", state="Running") == 1
    assert value(found, "state", state="Starting") == 0
    assert value(found, "reason", flags="adhesion", reason="Stale") == 1
    assert value(found, "reason", flags="thermal", reason="Config") == 1
    numbers = {
        "alive": 1, "heard": 1, "sample_age_seconds": 0.012, "flags_age_seconds": 0.003,
        "latency_p99_seconds": 0.0015, "lateness_p99_seconds": 0.00025,
        "reported_bus_load_ratio": 0.49, "deadline_misses_total": 4, "rejected_frames_total": 5,
        "lost_frames_total": 6, "link_bus_load_ratio": 0.515, "link_frames_per_second": 3667,
        "link_received_frames_total": 26253, "link_error_frames_total": 2,
        "link_unread_frames_total": 1, "monitor_viewers": 0,
    }  # fmt: skip
    assert {name: value(found, name) for name in numbers} == pytest.approx(numbers)
    assert value(found, "link_state", link_state="warning") is None
    assert value(found, "link_state", state="warning") == 1
    assert value(found, "link_rejected_frames_total", cause="crc") == 3
    assert value(found, "monitor_refused_total", cause="slow") == 2
    assert value(found, "events_total", level="error") == 3
    assert value(found, "events_total", level="info") == 0


def test_the_histogram_is_cumulative_and_ends_with_all():
    found = parsed(text_of())
    name = "flag_lateness_seconds"
    got = {dict(k[1])["le"]: v for k, v in found.items() if k[0] == f"{name}_bucket"}
    numbers = {float(edge): count for edge, count in got.items()}
    assert numbers == {1e-6: 10, 2e-6: 30, 4e-6: 30, 8e-6: 35, math.inf: 35}
    assert value(found, f"{name}_count") == 35


def test_what_is_not_known_has_no_number():
    found = parsed(text_of())
    of_two = {k[0]: v for k, v in found.items() if ("drive", "2") in k[1]}
    assert of_two.pop("drive_adhesion") == of_two.pop("drive_thermal") == Flag.UNKNOWN == 0
    assert of_two.pop("drive_rejected_frames_total") == 0
    assert value(found, "drive_health", drive="2", health="Unknown") == 1
    assert value(found, "drive_fault_class", drive="2", fault_class="Unknown") == 1
    states = {"drive_health", "drive_fault_class", "drive_state", "drive_heartbeat"}
    assert set(of_two) == states
    assert value(found, "drive_state", drive="2", state="Off") == 0
    bare = parsed(
        text_of(gateway=GatewayRow(), drives=(EMPTY,), link=LinkRow(), lateness=Lateness())
    )
    assert value(bare, "alive") == 0
    for name in ("sample_age_seconds", "deadline_misses_total", "link_bus_load_ratio"):
        assert value(bare, name) is None
    assert not [k for k in bare if k[0].startswith("flag_lateness")]
    assert not [v for v in (found | bare).values() if math.isnan(v)]


def test_a_state_of_which_nobody_has_heard_is_all_zero():
    row = DriveRow(1, state="Brewing", health=Health.TRACKING)
    found = parsed(text_of(drives=(row,)))
    assert {v for k, v in found.items() if k[0] == "drive_state"} == {0}


def test_before_the_first_look_there_is_only_the_monitor_itself():
    registry = CollectorRegistry(auto_describe=False)
    registry.register(FeedCollector(Feed(FakeSource())))
    names = {key[0] for key in parsed(generate_latest(registry).decode())}
    assert names == {"monitor_viewers", "events_total"}


def test_names_keep_the_conventions():
    """Prefix, snake case, base units, `_total` for what only counts; a line of help for each."""
    for family in text_string_to_metric_families(text_of()):
        assert re.fullmatch(r"traction_gateway_[a-z][a-z0-9_]*", family.name), family.name
        assert family.documentation
        assert not re.search(r"_(ms|us|pct|percent|nm|rpm|c|k|milli\w+|micro\w+)$", family.name)
        for sample in family.samples:
            assert (family.type == "counter") == sample.name.endswith("_total"), sample.name


def names_in(expression):
    return set(re.findall(r"\btraction_gateway_\w+", expression))


def expressions(node):
    if isinstance(node, dict):
        if node.get("type") == "datasource":
            return []
        texts = [node.get(k) for k in ("expr", "query", "definition")]
        own = [v for v in texts if isinstance(v, str)]
        return own + [e for v in node.values() for e in expressions(v)]
    return [e for v in node for e in expressions(v)] if isinstance(node, list) else []


def test_every_query_of_the_dashboard_names_what_exists():
    board = json.loads((EXAMPLES / "grafana.json").read_text())
    known = {}
    for family in text_string_to_metric_families(text_of()):
        for sample in family.samples:
            known.setdefault(sample.name, set()).update(sample.labels)
    found = expressions(board)
    assert len(found) > 20
    for expression in found:
        names = names_in(expression)
        assert names, expression
        assert names <= set(known), expression
        for name, inside in re.findall(r"(traction_gateway_\w+)\{([^}]*)\}", expression):
            used = set(re.findall(r"(\w+)\s*(?:=~|!~|!=|=)", inside))
            assert used <= known[name] | {"instance", "job"}, expression
        for labels in re.findall(r"by\s*\(([^)]*)\)", expression):
            assert set(re.split(r"[\s,]+", labels.strip())) <= set.union(
                {"instance", "job"}, *(known[name] for name in names)
            ), expression
    panels = [p for p in board["panels"] if p["type"] != "row"]
    assert len({p["id"] for p in board["panels"]}) == len(board["panels"])
    for panel in panels:
        assert expressions(panel), panel["title"]
        assert panel["gridPos"]["x"] + panel["gridPos"]["w"] <= 24

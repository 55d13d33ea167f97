"""The soaks, short: nothing that the gateway holds grows, and every frame is accounted for."""

import json
import math

import numpy as np
import pytest

from tests.soak.__main__ import RESULTS
from tests.soak.books import Books, wrong
from tests.soak.real import run
from tests.soak.virtual import full_traffic, slow_dbc, slow_messages
from tests.storm.train import LOOP_TICKS


def test_full_traffic_holds_nothing_and_leaves_nothing_out():
    rounds = 3
    seconds = rounds * LOOP_TICKS // 100
    soaked = full_traffic(seconds, every_s=LOOP_TICKS // 100)
    summary, blocks = soaked.summary(), soaked.books.blocks
    assert summary["unaccounted"] == 0
    assert summary["counts"]["received"] > 200_000
    # The same place in each round: one object held per tick would be 8000 more.
    assert max(blocks[1:]) - min(blocks[1:]) < 200
    sent = soaked.books.sent
    assert sent["Gateway_Adhesion"] == 100 * seconds
    assert sent["Gateway_Info"] == seconds
    assert sent["Drive3_Estimate"] == 50 * seconds
    assert soaked.said["adhesion GOOD"] > 15_000
    assert soaked.said["thermal BAD"] == 0


def test_slow_messages_keep_the_thermal_flags_good(tmp_path):
    soaked = slow_messages(3, slow_dbc(tmp_path), span_s=160, every_s=640)
    summary, blocks = soaked.summary(), soaked.books.blocks
    # One object held per second would be 640 more.
    assert summary["unaccounted"] == 0
    assert max(blocks[1:]) - min(blocks[1:]) < 200
    assert soaked.said["thermal BAD"] == 0
    assert soaked.said["thermal UNKNOWN"] < 100
    assert soaked.said["adhesion GOOD"] == 0


def test_the_live_loop_on_a_socket_counts_every_frame(tmp_path):
    result = run(3.0, tmp_path, every_s=0.5)
    # Seconds are too short for a slope of memory, and for a loop that falls behind: in them the age
    # at the end is that of whoever the machine let wait.
    assert wrong(result | {"rss_mb_per_hour": 0.0, "age_ms_last": 0.0}) == []
    assert result["frames_received"] > 15_000


def test_the_books_see_a_leak():
    books, held = Books(codec=None), []
    for hour in range(6):
        held += [object() for _ in range(1000)]
        books.read(hour)
    assert books.slope(books.blocks) == pytest.approx(1000.0, rel=0.1)
    assert np.isfinite(books.slope(books.rss_mb))


@pytest.mark.thorough  # each reading looks at all objects of the process
def test_the_books_hold_nothing_themselves():
    books = Books(codec=None)
    for hour in range(200):
        books.read(hour)
    # In lists it would be three a reading, 450 in all; others' threads hold something, too.
    assert books.blocks[-1] - books.blocks[50] < 150


KEPT = json.loads(RESULTS.read_text())


@pytest.mark.parametrize("kind", ["full", "slow", "real"])
def test_the_results_that_are_kept_are_right(kind):
    assert wrong(KEPT[kind]) == []


@pytest.mark.parametrize(
    "change",
    [
        {"unaccounted": 1}, {"rss_mb_per_hour": 1.1}, {"rss_mb_per_hour": math.nan},
        {"descriptors_most": 1 + KEPT["real"]["descriptors_first"]},
        {"ticks": KEPT["real"]["ticks"] + 1}, {"sent": {}}, {"frames_received": 1},
        {"frames_sent_to_it": 1 + KEPT["real"]["frames_received"]}, {"kernel_drops": 1},
        {"age_ms_last": 101.0}, {"age_ms_last": math.nan}, {"counts": {"received": 5}},
    ],
)  # fmt: skip
def test_a_soak_that_went_wrong_says_so(change):
    assert len(wrong(KEPT["real"] | change)) == 1

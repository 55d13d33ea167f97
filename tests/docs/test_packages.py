"""The picture of the packages shows the imports as they are."""

import random

import pytest

from tests.docs.packages import PICTURE, imports, layers, reachable, reduced, svg


def test_the_picture_is_the_one_that_the_import_graph_gives():
    assert PICTURE.read_text(encoding="utf-8") == svg(), "python -m tests.docs.packages draws it"


def test_every_arrow_leads_down():
    rows = layers()
    height = {name: y for y, row in enumerate(rows) for name in row}
    found = imports(set(height))
    assert sum(len(targets) for targets in found.values()) > 30
    assert not [(a, b) for a, targets in found.items() for b in targets if height[b] <= height[a]]


@pytest.mark.parametrize("seed", range(20))
def test_arrows_left_out_are_implied_and_those_left_are_needed(seed):
    chance = random.Random(seed)
    names = [f"n{i}" for i in range(9)]
    edges = {a: {b for b in names[i + 1 :] if chance.random() < 0.4} for i, a in enumerate(names)}
    few = reduced(edges)
    assert all(reachable(few, a) == reachable(edges, a) for a in names)
    for a in names:
        for b in few[a]:
            fewer = {**few, a: few[a] - {b}}
            assert b not in reachable(fewer, a)

"""The picture of the packages shows the imports as they are."""

import random
import re

import pytest

from tests.docs.packages import PICTURE, ROOT, imports, layers, reachable, reduced, svg

INCLUDE = re.compile(r'#include "([^"]+)"')
RECORDS = "gateway/core/records.h"


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


def test_includes_lead_down_as_imports_do():
    """C has no packages: the folders are. One header holds the records of all."""
    height = {name.replace(".", "/"): y for y, row in enumerate(layers()) for name in row}

    def package(path):
        return next(name for name in height if path.startswith(f"{name}/"))

    wrong, found = [], 0
    for folder in ("dbc", "estimators", "gateway", "sim"):
        for source in (ROOT / folder).rglob("*.[ch]"):
            own = package(str(source.relative_to(ROOT)))
            for target in INCLUDE.findall(source.read_text(encoding="utf-8")):
                found += 1
                down = own == package(target) or height[own] < height[package(target)]
                if not down and target != RECORDS:
                    wrong.append(f"{source.name}: {target}")
    assert found > 100
    assert not wrong

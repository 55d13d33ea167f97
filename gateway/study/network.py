"""A simulated sensor network: links between neighbours, and two ways to compute sums over it.

Time advances in synchronous rounds: a message sent in one round arrives in the next. A node uses
only its own store and its received messages, never another node's store. `Traffic` counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final, NamedTuple

import numpy as np

from dbc.arrays import Array

Graph = tuple[tuple[int, ...], ...]
"""Neighbours of each node, in ascending order."""

TOLERANCE: Final = 1e-12
"""Consensus ends when all nodes agree to this, relative to 1 + |value|."""

WINDOWS: Final = 10_000
"""Consensus gives up after this many windows of N - 1 rounds; `Consensus.agreed` is then False."""

HELLO: Final = 0.0
JOIN: Final = 1.0


class Traffic(NamedTuple):
    """Traffic over the edges: messages, bytes of payload, synchronous rounds."""

    messages: int
    bytes: int
    rounds: int


def graph(nodes: int, edges: Iterable[tuple[int, int]]) -> Graph:
    """Graph of `nodes` nodes. Raises ValueError for loops, unknown or unconnected nodes."""
    near: list[set[int]] = [set() for _ in range(nodes)]
    for i, j in edges:
        if i == j or not (0 <= i < nodes and 0 <= j < nodes):
            raise ValueError(f"no edge {i}-{j} among {nodes} nodes")
        near[i].add(j)
        near[j].add(i)
    reached, edge = {0}, {0}
    while edge:
        edge = set().union(*(near[i] for i in edge)) - reached
        reached |= edge
    if len(reached) < nodes:
        raise ValueError(f"nodes {sorted(set(range(nodes)) - reached)} are not connected to 0")
    return tuple(tuple(sorted(n)) for n in near)


def ring(nodes: int) -> Graph:
    """Ring graph: each node is connected to the next, the last to the first."""
    return graph(nodes, [(i, (i + 1) % nodes) for i in range(nodes) if nodes > 1])


def tree(nodes: int, children: int = 2) -> Graph:
    """Tree graph: node i's parent is (i - 1) // children; 1 gives a line, nodes - 1 a star."""
    return graph(nodes, [(i, (i - 1) // children) for i in range(1, nodes)])


class Wires:
    """The edges, which carry arrays between neighbours, a round at a time, and count them."""

    def __init__(self, near: Graph) -> None:
        self.near = near
        self.messages = self.bytes = self.rounds = 0
        self.sent: list[tuple[int, int, Array]] = []

    def send(self, source: int, target: int, payload: Array) -> None:
        """Send one message; `deliver` hands it over."""
        assert target in self.near[source]
        self.sent.append((source, target, payload))
        self.messages += 1
        self.bytes += 8 * payload.size

    def deliver(self) -> list[dict[int, Array]]:
        """End the round; return the messages that each node received, by sender."""
        inbox: list[dict[int, Array]] = [{} for _ in self.near]
        for source, target, payload in self.sent:
            inbox[target][source] = payload
        self.sent = []
        self.rounds += 1
        return inbox

    def traffic(self) -> Traffic:
        """Traffic so far."""
        return Traffic(self.messages, self.bytes, self.rounds)


class Tree:
    """Spanning tree found by a flood; node i uses only parent[i] and children[i].

    The flood costs at most two messages per edge, and one per node that joins.
    """

    agreed = True
    """Exact: see `Consensus.agreed`."""

    def __init__(self, wires: Wires) -> None:
        self.wires = wires
        n = len(wires.near)
        self.parent: list[int | None] = [None] * n
        self.children: list[list[int]] = [[] for _ in range(n)]
        joined = [i == 0 for i in range(n)]
        for target in wires.near[0]:
            wires.send(0, target, np.array([HELLO]))
        while wires.sent:
            for i, inbox in enumerate(wires.deliver()):
                hellos = [source for source, payload in inbox.items() if payload[0] == HELLO]
                self.children[i] += [source for source in inbox if source not in hellos]
                if not hellos or joined[i]:
                    continue
                joined[i] = True
                self.parent[i] = min(hellos)
                wires.send(i, min(hellos), np.array([JOIN]))
                for target in set(wires.near[i]).difference(hellos):
                    wires.send(i, target, np.array([HELLO]))

    def total(self, values: list[Array]) -> list[Array]:
        """Every node's copy of the sum."""
        return self._join(values, np.add)

    def largest(self, values: list[Array]) -> list[Array]:
        """Every node's copy of the elementwise maximum."""
        return self._join(values, np.maximum)

    def _join(self, values: list[Array], join: Callable[[Array, Array], Array]) -> list[Array]:
        """Up: a node sends once all its children have sent. Down: the root's result, unchanged."""
        store = list(values)
        missing = [set(c) for c in self.children]
        spoken = [False] * len(values)
        while missing[0]:
            for i, parent in enumerate(self.parent):
                if parent is not None and not missing[i] and not spoken[i]:
                    self.wires.send(i, parent, store[i])
                    spoken[i] = True
            for i, inbox in enumerate(self.wires.deliver()):
                for source in sorted(inbox):
                    store[i] = join(store[i], inbox[source])
                missing[i].difference_update(inbox)
        speaking = [0]
        while any(self.children[i] for i in speaking):
            for i in speaking:
                for child in self.children[i]:
                    self.wires.send(i, child, store[i])
            speaking = []
            for i, inbox in enumerate(self.wires.deliver()):
                for payload in inbox.values():
                    store[i] = payload
                    speaking.append(i)
        return store


class Consensus:
    """Averaging with all neighbours, with Metropolis weights from the nodes' degrees."""

    def __init__(self, wires: Wires) -> None:
        self.wires = wires
        self.agreed = True
        degree = [np.array([float(len(near))]) for near in wires.near]
        self.weight = [
            {j: 1.0 / (1.0 + max(degree[i][0], d[0])) for j, d in inbox.items()}
            for i, inbox in enumerate(self._exchange(degree))
        ]

    def _exchange(self, values: list[Array]) -> list[dict[int, Array]]:
        """Each node sends its value to all neighbours: one round."""
        for i, near in enumerate(self.wires.near):
            for j in near:
                self.wires.send(i, j, values[i])
        return self.wires.deliver()

    def largest(self, values: list[Array]) -> list[Array]:
        """Every node's copy of the elementwise maximum: N - 1 rounds reach the furthest."""
        for _ in range(len(values) - 1):
            values = [
                np.max([value, *inbox.values()], axis=0)
                for value, inbox in zip(values, self._exchange(values), strict=True)
            ]
        return values

    def total(self, values: list[Array]) -> list[Array]:
        """N times the average, equal at all nodes to `TOLERANCE`.

        In windows of N - 1 rounds: the averaging goes on while maximum and minimum at the start
        of the window are flooded, so that at its end all nodes know how far apart they were.
        """
        n, size = len(values), len(values[0])
        if n == 1:
            return values
        for _ in range(WINDOWS):
            packed = [np.concatenate([v, v, -v]) for v in values]
            for _ in range(n - 1):
                packed = [
                    self._mix(own, inbox, weight, size)
                    for own, inbox, weight in zip(
                        packed, self._exchange(packed), self.weight, strict=True
                    )
                ]
            values = [p[:size] for p in packed]
            # The flooded extremes are now equal at all nodes, and so is the decision.
            high, low = packed[0][size : 2 * size], -packed[0][2 * size :]
            if not (high - low > TOLERANCE * (1.0 + np.maximum(np.abs(high), np.abs(low)))).any():
                return [n * v for v in values]
        self.agreed = False
        return [n * v for v in values]

    @staticmethod
    def _mix(own: Array, inbox: dict[int, Array], weight: dict[int, float], size: int) -> Array:
        out = own.copy()
        for source in sorted(inbox):
            out[:size] += weight[source] * (inbox[source][:size] - own[:size])
            np.maximum(out[size:], inbox[source][size:], out=out[size:])
        return out

"""A receiver of authenticated flags against every bus that hypothesis thinks of."""

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from dbc.frame import MS, SECOND
from dbc.secoc_receiver import AT_ONCE, QUIET_NS, SURE, SWEEP, TRIPS, TURNS, WINDOW, Verifier
from dbc.secoc_sender import Authenticator
from tests.fuzz import examples

KEY = bytes(range(16))
OTHER = bytes(range(1, 17))
KEYS = st.sampled_from((0x1A0, 0x2A0))
SWEEPS = (TRIPS + 1) * TURNS // SWEEP
"""Frames in which everything is tried once."""
Pair = tuple[int, bytes, int, int, int]
"""Identifier, data, low bits, MAC, place in the sender's order."""


class Bus(RuleBasedStateMachine):
    """A sender that is started again at will, and a bus that loses, repeats, reorders, forges."""

    def __init__(self):
        super().__init__()
        self.trip = 1
        self.sender = Authenticator(KEY, 1)
        self.receiver = Verifier(KEY, self.sender.freshness)
        self.now = 1000 * SECOND
        self.heard_ns = self.now
        self.made = []
        self.accepted = []
        self.missed = 0
        self.starts = 0

    def make(self, key):
        data = len(self.made).to_bytes(8, "big")
        self.made.append((key, data, *self.sender.sign(key, data), len(self.made)))
        return self.made[-1]

    def hear(self, key, data, low, mac):
        self.receiver.flag(key, data, self.now)
        return self.take(low, mac)

    def take(self, low, mac):
        genuine = self.receiver.auth(low, mac, self.now)
        if genuine is None:
            return False
        place = int.from_bytes(genuine.data, "big")
        assert place < len(self.made), "nobody made this frame"
        assert (genuine.key, genuine.data) == self.made[place][:2]
        self.accepted.append(place)
        return True

    def arrive(self, key):
        """The next genuine pair reaches the receiver."""
        self.now += 10 * MS
        pair = self.make(key)
        if self.hear(*pair[:4]):
            assert self.accepted[-1] == pair[4]
            self.missed = self.starts = 0
            self.heard_ns = self.now
            return True
        return False

    @rule(key=KEYS)
    def genuine(self, key):
        in_reach = self.starts == 0 and self.missed < WINDOW
        self.missed += 1
        assert self.arrive(key) or not in_reach

    @rule(key=KEYS)
    def genuine_for_a_while(self, key):
        """Whatever was before: a sender that goes on is believed, and stays so."""
        self.now += QUIET_NS
        near = self.starts <= AT_ONCE and self.missed < 60_000
        first = SURE if near else SURE + SWEEPS
        heard = [self.arrive(key) for _ in range(first + 2)]
        assert all(heard[first - 1 :])

    @rule(count=st.integers(1, 3 * WINDOW))
    def lost(self, count):
        self.sender.freshness += count
        self.missed += count
        self.now += 10 * MS * count

    @precondition(lambda self: self.starts < TRIPS)
    @rule(steps=st.integers(1, 3))
    def restarted(self, steps):
        steps = min(steps, TRIPS - self.starts)
        self.trip += steps
        self.starts += steps
        self.sender = Authenticator(KEY, self.trip)
        self.now += SECOND

    @rule(ns=st.integers(0, 5 * SECOND))
    def silence(self, ns):
        self.now += ns

    @precondition(lambda self: self.made)
    @rule(data=st.data())
    def repeated(self, data):
        """Any pair of the past, also of those that were accepted or overtaken."""
        pair = data.draw(st.sampled_from(self.made))
        before = list(self.accepted)
        assert not self.hear(*pair[:4]) or pair[4] > max(before, default=-1)

    @precondition(lambda self: self.made)
    @rule(data=st.data(), changed=st.binary(min_size=8, max_size=8), key=KEYS)
    def forged_flag(self, data, changed, key):
        """A true tag behind a flag frame that it does not belong to."""
        pair = data.draw(st.sampled_from(self.made))
        if (key, changed) != pair[:2]:
            self.hear(key, changed, *pair[2:4])

    @rule(key=KEYS, changed=st.binary(min_size=8, max_size=8), low=st.integers(0, 0xFFFF),
          mac=st.integers(0, 0xFFFFFFFF), times=st.integers(1, 40))  # fmt: skip
    def forged(self, key, changed, low, mac, times):
        for k in range(times):
            self.hear(key, b"\xff" + changed[1:], low, (mac + k) & 0xFFFFFFFF)

    @rule(key=KEYS)
    def of_another_key(self, key):
        forger = Authenticator(OTHER, self.trip)
        forger.freshness = self.sender.freshness
        data = b"\xff" * 8
        assert not self.hear(key, data, *forger.sign(key, data))

    @rule(key=KEYS, forgeries=st.integers(1, 60), low=st.integers(0, 0xFFFF))
    def flooded(self, key, forgeries, low):
        """Forged tags between a flag frame and its own: it still counts, as it would without."""
        in_reach = self.starts == 0 and self.missed < WINDOW
        self.now += 10 * MS
        self.missed += 1
        pair = self.make(key)
        self.receiver.flag(pair[0], pair[1], self.now)
        for k in range(forgeries):
            assert not self.take(low, (pair[3] + 1 + k) & 0xFFFFFFFF)
        if self.take(*pair[2:4]):
            assert self.accepted[-1] == pair[4]
            self.missed = self.starts = 0
        else:
            assert not in_reach

    @rule()
    def receiver_restarted(self):
        """It has kept its freshness."""
        self.receiver = Verifier(KEY, self.receiver.freshness)

    @invariant()
    def accepted_once_and_forwards(self):
        assert self.accepted == sorted(set(self.accepted))


Bus.TestCase.settings = settings(max_examples=examples(150), stateful_step_count=40, deadline=None)
TestBus = Bus.TestCase

"""The receiver against a model that keeps everything and counts from scratch."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from dbc.dataids import p02_data_ids
from dbc.e2e import Check, Profile, Receiver, SmState, protect
from tests.strategies import checks


class Spec:
    profile = Profile.P02
    data_ids = p02_data_ids(0x181)


def model(history: list[Check]) -> SmState:
    """SWS_E2E_00345 read aloud: at every cycle count OK and ERROR among the last five."""
    state = SmState.NO_DATA
    for k in range(len(history)):
        window = history[max(0, k - 4) : k + 1]
        oks = sum(check in (Check.OK, Check.OK_SOME_LOST) for check in window)
        errors = window.count(Check.ERROR)
        if state is SmState.NO_DATA:
            if history[k] not in (Check.ERROR, Check.NO_NEW_DATA):
                state = SmState.INIT
        elif state is SmState.INIT:
            if errors > 0:
                state = SmState.INVALID
            elif oks >= 2:
                state = SmState.VALID
        elif state is SmState.VALID:
            if errors > 1 or oks < 2:
                state = SmState.INVALID
        elif errors == 0 and oks >= 3:
            state = SmState.VALID
    return state


@given(st.lists(checks(), max_size=40))
@settings(deadline=None)
def test_states_equal_the_model(history: list[Check]) -> None:
    receiver = Receiver(Spec())
    for k, check in enumerate(history):
        assert receiver.cycle(check) is model(history[: k + 1])


class Channel(RuleBasedStateMachine):
    """A sender, a channel that loses, repeats, corrupts and falls silent, and the receiver."""

    def __init__(self) -> None:
        super().__init__()
        self.receiver = Receiver(Spec())
        self.counter = 0
        self.last: bytes | None = None
        self.last_counter: int | None = None
        self.history: list[Check] = []
        self.frames = 0

    def deliver(self, data: bytes) -> Check:
        self.frames += 1
        check = self.receiver.check(data)
        self.receiver.cycle(check)
        self.history.append(check)
        return check

    @rule(lost=st.integers(0, 20), body=st.binary(min_size=6, max_size=6))
    def send(self, lost: int, body: bytes) -> None:
        self.counter += lost
        payload = bytearray(2) + bytearray(body)
        protect(Spec(), payload, self.counter)
        check = self.deliver(bytes(payload))
        delta = None if self.last_counter is None else (self.counter - self.last_counter) % 16
        if delta is None or delta == 1:
            assert check is Check.OK
        elif delta == 0:
            assert check is Check.REPEATED
        elif delta <= 3:
            assert check is Check.OK_SOME_LOST
            assert self.receiver.missed == delta - 1
        else:
            assert check is Check.WRONG_SEQUENCE
        self.last, self.last_counter = bytes(payload), self.counter
        self.counter += 1

    @rule()
    def repeat(self) -> None:
        if self.last is not None:
            assert self.deliver(self.last) is Check.REPEATED

    @rule(bit=st.integers(0, 63))
    def corrupt(self, bit: int) -> None:
        if self.last is not None:
            broken = bytearray(self.last)
            broken[bit >> 3] ^= 1 << (bit & 7)
            assert self.deliver(bytes(broken)) is Check.ERROR

    @rule(data=st.binary(max_size=1))
    def cut(self, data: bytes) -> None:
        assert self.deliver(data) is Check.ERROR

    @rule()
    def silence(self) -> None:
        self.receiver.cycle(Check.NO_NEW_DATA)
        self.history.append(Check.NO_NEW_DATA)

    @invariant()
    def state_is_the_models(self) -> None:
        assert self.receiver.state is model(self.history)

    @invariant()
    def every_frame_is_in_one_count(self) -> None:
        assert sum(self.receiver.counts) == self.frames

    @invariant()
    def valid_only_on_recent_good_frames(self) -> None:
        if self.receiver.state is SmState.VALID:
            recent = self.history[-5:]
            assert sum(check <= Check.OK_SOME_LOST for check in recent) >= 2
            assert recent.count(Check.ERROR) <= 1


TestChannel = Channel.TestCase
TestChannel.settings = settings(deadline=None)

"""Authentication of flag frames, receiver's side: which of the flag frames heard are genuine. Pure.

A flag frame waits until a `Gateway_Auth` vouches for it. What fails is dropped and counted, and
nothing that fails is held against the frames that follow: a forger can add frames, not take the
sender's away. The upper 48 bits of the freshness are the receiver's own knowledge:

- it accepts at once what is newer than the last genuine frame by up to `WINDOW` frames;
- after `QUIET_NS` without a genuine one it also looks further ahead: the sender may have been
  started again (a higher start number, up to `TRIPS`) or was not heard for long (up to `TURNS`
  times 65,536 frames). As many guesses make a chance hit likelier, the first `SURE` - 1 frames
  that fit are not believed, only used to find the place.

Freshness says "newer than the last I heard", not "now": see docs/threats.md. A receiver that can be
switched off has to keep `freshness`, or recordings of what it never heard are new to it.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import Final, NamedTuple

from dbc.frame import MS, SECOND, Nanos
from dbc.secoc_sender import COUNT_BITS, FRESHNESS_BITS, SENT_BITS, Macs

WINDOW: Final = 1024
"""A gap of so many frames is bridged at once: nine seconds at 110 a second."""
SURE: Final = 3
"""Frames in a row that fit a guess before one is believed."""
TRIPS: Final = 64
"""Starts of the sender that may have gone unheard."""
AT_ONCE: Final = 4
"""Of these as many are looked for with every frame; more take a sweep, which a flood delays."""
TURNS: Final = 256
"""Times 65,536 frames of one start that may have gone unheard: 42 hours at 110 a second."""
QUIET_NS: Final[Nanos] = 200 * MS
WAITING: Final = 2
"""Newest flag frames of an identifier that may wait: each is one more chance for a guessed MAC."""
WAITING_NS: Final[Nanos] = 20 * MS
GUESS_NS: Final[Nanos] = SECOND
"""A guess that nothing confirms is forgotten."""
SWEEP: Final = 256
"""Guesses for one frame .."""
SWEEP_RATE: Final = 100 * SWEEP
"""..and in a second: what an unheard-of sender costs at most."""
NOTICE_NS: Final[Nanos] = SECOND
_TURN_BITS: Final = COUNT_BITS - SENT_BITS
_NEVER: Final[Nanos] = -(1 << 62)


class Genuine(NamedTuple):
    """A flag frame that the sender vouches for; key as `MessageSpec.key`, t_ns of its reception."""

    key: int
    data: bytes
    t_ns: Nanos


class Verifier:
    """One receiver. Give every flag frame to `flag`, every `Gateway_Auth` to `auth`.

    Counts: accepted; failed (no flag frame that waits fits); alone (none waits at all); held
    (fits a guess that is not sure yet).
    """

    def __init__(self, key: bytes, freshness: int = 0) -> None:
        """freshness: as kept of an earlier run, so that nothing older counts as new."""
        self._macs = Macs(key)
        self.freshness = freshness
        """Of the newest genuine frame; to be kept by whoever keeps this receiver's memory."""
        self.accepted = self.failed = self.alone = self.held = 0
        self._waiting: list[Genuine] = []
        self._received_ns: Nanos = _NEVER
        self._guess = 0
        self._guess_ns: Nanos = _NEVER
        self._fits = 0
        self._place = 0
        self._tokens = 0.0
        self._tokens_ns: Nanos = 0
        self._reported = 0
        self._reported_ns: Nanos = _NEVER

    def flag(self, key: int, data: bytes, now: Nanos) -> None:
        """A flag frame came: nothing is believed yet."""
        self._waiting.append(Genuine(key, data, now))
        same = [w for w in self._waiting if w.key == key]
        if len(same) > WAITING:
            self._waiting.remove(same[0])

    def auth(self, low: int, mac: int, now: Nanos) -> Genuine | None:
        """A `Gateway_Auth` came; gives the flag frame that is genuine now. Never raises."""
        self._waiting = [w for w in self._waiting if now - w.t_ns <= WAITING_NS]
        if not self._waiting:
            self.alone += 1
            return None
        value = _after(self.freshness, low)
        if value - self.freshness <= WINDOW:
            found = self._fitting(value, mac, self._waiting)
            if found is not None:
                return self._accept(found, value, now)
        if now - self._received_ns >= QUIET_NS:
            return self._look_ahead(low, mac, now)
        self.failed += 1
        return None

    def notice(self, now: Nanos) -> str | None:
        """What a person should know, at most once a second; None if nothing is new."""
        wrong = self.failed + self.alone
        if wrong == self._reported or now - self._reported_ns < NOTICE_NS:
            return None
        new, self._reported, self._reported_ns = wrong - self._reported, wrong, now
        return (
            f"{new} frames failed authentication ({self.failed} forged, old or unheard-of, "
            f"{self.alone} without a flag frame, {self.accepted} genuine so far)"
        )

    def _accept(self, found: Genuine, value: int, now: Nanos) -> Genuine:
        self._waiting.remove(found)
        self.freshness = value
        self.accepted += 1
        self._received_ns = now
        self._guess_ns, self._place = _NEVER, 0
        return found

    def _look_ahead(self, low: int, mac: int, now: Nanos) -> Genuine | None:
        """Further than the window. A frame that does not fit is not held against the guess."""
        if now - self._guess_ns > GUESS_NS:
            self._guess, self._fits = 0, 0
        elif (value := _after(self._guess, low)) - self._guess <= WINDOW:
            found = self._fitting(value, mac, self._waiting)
            if found is not None:
                self._guess, self._guess_ns, self._fits = value, now, self._fits + 1
                if self._fits >= SURE:
                    return self._accept(found, value, now)
                self._waiting.remove(found)
                self.held += 1
                return None
        if self._guesses(low, mac, now):
            self.held += 1
        else:
            self.failed += 1
        return None

    def _guesses(self, low: int, mac: int, now: Nanos) -> bool:
        """Whether a new guess was found, for the newest flag frame that waits.

        It must be newer than the guess before: what is genuine now is newer than any recording.
        """
        newest = self._waiting[-1:]
        for upper in chain(self._likely(), self._sweep(now)):
            value = upper << SENT_BITS | low
            if value <= max(self.freshness, self._guess):
                continue
            if self._fitting(value, mac, newest) is not None:
                self._guess, self._guess_ns, self._fits = value, now, 1
                self._waiting.pop()
                return True
        return False

    def _likely(self) -> tuple[int, ...]:
        """Upper bits tried for every frame, whatever a flood has used up: a gap, a new start."""
        upper = self.freshness >> SENT_BITS
        trip = upper >> _TURN_BITS
        return (upper, upper + 1, *(trip + k << _TURN_BITS for k in range(1, AT_ONCE + 1)))

    def _sweep(self, now: Nanos) -> Iterator[int]:
        """The next upper bits of all, the fewest turns first; as many as may be tried now."""
        rate = SWEEP_RATE / SECOND
        since = max(0, now - self._tokens_ns)
        self._tokens = min(float(SWEEP), self._tokens + since * rate)
        self._tokens_ns = now
        count = int(self._tokens)
        self._tokens -= count
        upper = self.freshness >> SENT_BITS
        trip = upper >> _TURN_BITS
        for _ in range(count):
            turn, ahead = divmod(self._place, TRIPS + 1)
            self._place = (self._place + 1) % (TURNS * (TRIPS + 1))
            yield (trip + ahead << _TURN_BITS) + turn if ahead else upper + turn

    def _fitting(self, value: int, mac: int, waiting: list[Genuine]) -> Genuine | None:
        """The newest waiting flag frame with this MAC."""
        if value >> FRESHNESS_BITS:
            return None
        for frame in reversed(waiting):
            if self._macs.of(frame.key, frame.data, value) == mac:
                return frame
        return None


def _after(last: int, low: int) -> int:
    """The next freshness after `last` with these low bits."""
    return last + 1 + ((low - last - 1) & ((1 << SENT_BITS) - 1))

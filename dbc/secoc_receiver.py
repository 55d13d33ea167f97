"""Authentication of flag frames, receiver's side: find the genuine ones among those received. Pure.

A flag frame waits until a `Gateway_Auth` authenticates it. A frame that fails is dropped and
counted. It does not affect the frames that follow, because a forger can add frames but cannot
remove the sender's. The upper 48 bits of the freshness are not sent; the receiver finds them:

- it accepts at once a freshness up to `WINDOW` frames ahead of the last genuine frame;
- after `QUIET_NS` without a genuine frame it also searches further ahead. The sender may have been
  restarted (start number higher by up to `TRIPS`) or not received for long (up to `TURNS` times
  65,536 frames). So many guesses make a chance match likelier: the first `SURE` - 1 frames that
  match are not accepted, but only used to find the freshness.

Freshness proves "newer than the last frame received", not "now": see docs/threats.md. A receiver
that can be switched off has to store `freshness`; else it accepts recordings of frames that it
never received.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import Final, NamedTuple

from dbc.frame import MS, SECOND, Nanos
from dbc.secoc_sender import COUNT_BITS, FRESHNESS_BITS, SENT_BITS, Macs

WINDOW: Final = 1024
"""Longest gap in frames that is bridged at once: nine seconds at 110 frames a second."""
SURE: Final = 3
"""Number of frames that have to match a guess before one is accepted."""
TRIPS: Final = 64
"""Most starts of the sender that the receiver may have missed."""
AT_ONCE: Final = 4
"""Number of these starts tried with every frame; more need a sweep, which a flood delays."""
TURNS: Final = 256
"""Most missed frames of one start, in units of 65,536: 42 hours at 110 frames a second."""
QUIET_NS: Final[Nanos] = 200 * MS
WAITING: Final = 2
"""Most waiting flag frames of an identifier: each is one more chance for a guessed MAC."""
WAITING_NS: Final[Nanos] = 20 * MS
GUESS_NS: Final[Nanos] = SECOND
"""A guess that no frame confirms within this time is dropped."""
SWEEP: Final = 256
"""Most guesses of a sweep for one frame .."""
SWEEP_RATE: Final = 100 * SWEEP
""".. and in a second: the most work that an unknown sender can cause."""
NOTICE_NS: Final[Nanos] = SECOND
_TURN_BITS: Final = COUNT_BITS - SENT_BITS
_NEVER: Final[Nanos] = -(1 << 62)


class Genuine(NamedTuple):
    """A flag frame, genuine if `Verifier.auth` returned it; key: see `MessageSpec`; t_ns: stamp."""

    key: int
    data: bytes
    t_ns: Nanos


class Verifier:
    """One receiver. Pass every flag frame to `flag`, and every `Gateway_Auth` to `auth`.

    Counts of `Gateway_Auth`: accepted; failed (no waiting flag frame matches); alone (no flag frame
    waits); held (matches a guess that is not confirmed yet).
    """

    def __init__(self, key: bytes, freshness: int = 0) -> None:
        """freshness: value stored in an earlier run, so that no older frame is accepted."""
        self._macs = Macs(key)
        self.freshness = freshness
        """Freshness of the newest genuine frame; the caller has to store it for the next run."""
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
        """Add a received flag frame to those that wait for authentication."""
        self._waiting.append(Genuine(key, data, now))
        same = [w for w in self._waiting if w.key == key]
        if len(same) > WAITING:
            self._waiting.remove(same[0])

    def auth(self, low: int, mac: int, now: Nanos) -> Genuine | None:
        """Return the flag frame that this `Gateway_Auth` makes genuine, or None. Never raises."""
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
        """Message for a person about new failures, at most once a second; None without any."""
        wrong = self.failed + self.alone
        if wrong == self._reported or now - self._reported_ns < NOTICE_NS:
            return None
        new, self._reported, self._reported_ns = wrong - self._reported, wrong, now
        return (
            f"{new} more frames failed authentication ({self.failed} with a wrong MAC or "
            f"freshness, {self.alone} without a flag frame, {self.accepted} genuine so far)"
        )

    def _accept(self, found: Genuine, value: int, now: Nanos) -> Genuine:
        self._waiting.remove(found)
        self.freshness = value
        self.accepted += 1
        self._received_ns = now
        self._guess_ns, self._place = _NEVER, 0
        return found

    def _look_ahead(self, low: int, mac: int, now: Nanos) -> Genuine | None:
        """Search beyond the window. A frame that does not match leaves the guess as it is."""
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
        """Whether a new guess was found for the newest waiting flag frame.

        It must be newer than the guess before: a frame that is genuine now is newer than any
        recording.
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
        """Upper bits tried for every frame, without a limit of rate: for a gap or a new start."""
        upper = self.freshness >> SENT_BITS
        trip = upper >> _TURN_BITS
        return (upper, upper + 1, *(trip + k << _TURN_BITS for k in range(1, AT_ONCE + 1)))

    def _sweep(self, now: Nanos) -> Iterator[int]:
        """Yield the next upper bits to try, fewest turns first, as many as the rate allows now."""
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

"""`gateway/core/sample_clock.c` by due stamps and complex numbers."""

from __future__ import annotations

import cmath


class SampleClock:
    """When the samples of one drive were due, ns, and how far its voltage turns in a period."""

    def __init__(self, t: int, u: complex, period: int, most: int) -> None:
        """Begin at a sample; most: lateness beyond which nothing is followed."""
        self.period, self.most = period, most
        self.due, self.stamp, self.usual, self.seen, self.mean = t, t, 0, 0, period
        self.u, self.turn = u, 0j

    @property
    def late(self) -> int:
        """Of the last sample."""
        return self.stamp - self.due

    def left_out(self, turn: complex, cycles: int, late: int) -> int:
        """Periods that nobody counted before a sample that is so late."""
        unusual = self.seen >= 16 and late - self.usual > 3 * self.period // 4
        periods = (late + self.period // 4) // self.period if unusual else 0
        each = cmath.phase(self.turn)

        def fits(n: int) -> bool:
            off = abs(cmath.phase(turn * cmath.exp(-1j * each * n)))
            return abs(each) > 0.05 and off < 0.35 * abs(each)

        known = 0 < periods <= 8 - cycles and not fits(cycles)
        return periods if known and fits(cycles + periods) else 0

    def step(self, passed: int, u: complex, cycles: int) -> int:
        """Go on to a sample `passed` after the one before; returns the periods left out."""
        t, due = self.stamp + passed, self.due + cycles * self.period
        late = min(max(t - due, 0), self.most)
        turn = u * self.u.conjugate()
        periods = self.left_out(turn, cycles, late)
        passed -= periods * self.period
        # C divides towards 0.
        self.mean += int((int(passed / cycles) - self.mean) / 64)
        late = min(max(t - due - periods * self.period, 0), self.most)
        off = self.mean - self.period
        steady = -(self.period // 8) < off < self.period // 8
        late = late - late // 256 if steady else 0
        self.stamp, self.due = t, t - late
        self.usual = max(self.usual - self.usual // 64, late)
        self.seen += 1
        if cycles == 1 and periods == 0:
            self.turn += 0.25 * (turn - self.turn)
        self.u = u
        return periods

"""Keywords for Robot Framework: scenarios of traction-gateway on the virtual clock.

Needs the extra `pandas`, for the table of events.
"""

import gateway


class Traction:
    """One run at a time: the last that `Run Scenario` made."""

    ROBOT_LIBRARY_SCOPE = "TEST"

    def run_scenario(self, name: str, config: str | None = None):
        """A scenario that ships, or a file; with a configuration of your own."""
        self.run = gateway.scenario(name).run(config)

    def all_expectations_should_hold(self):
        failed = [f"{v.text}: {v.detail}" for v in self.run.verdicts if not v.passed]
        if failed or not self.run.passed:
            raise AssertionError("\n".join(failed) or "the scenario has no expectation")

    def flag_should_become(
        self, flag: str, state: str, drive: int, after_s: float, within_ms: float
    ):
        """The flag `adhesion` or `thermal` of a drive changes to `AdhesionLost`, `Adhering` .."""
        times = self._times(flag, state, drive)
        if not any(after_s <= t_s <= after_s + within_ms / 1000 for t_s in times):
            raise AssertionError(f"drive {drive}: {flag} became {state} at {times} s")

    def flag_should_never_become(self, flag: str, state: str, drive: int):
        if times := self._times(flag, state, drive):
            raise AssertionError(f"drive {drive}: {flag} became {state} at {times} s")

    def adhesion_should_be_known(self, percent: float):
        """Of every drive, for so much of the time: a flag that knows nothing accuses nobody."""
        known = self.run.known["adhesion"]
        if min(known.values()) < percent:
            raise AssertionError(f"known by drive, percent: {known}")

    def _times(self, flag, state, drive):
        return [
            row["t_s"]
            for row in self.run.events.to_pylist()
            if (row["flag"], row["state"], row["drive"]) == (flag, state, drive)
        ]

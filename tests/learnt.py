"""Load references and responses of the compiled core in tests: arrays in, arrays out."""

import numpy as np
from _traction_core import ffi, lib

from dbc.records import COMMAND_RESPONSE, LOAD_OBSERVATION, LOAD_RATIO, LOAD_SPREAD


class Loads:
    """What is learnt of N drives' loads: `estimators/detect/load_reference.c`."""

    def __init__(self, n, spread):
        self.ratios = np.zeros(n, LOAD_RATIO)
        self.all = ffi.from_buffer("struct load_spread *", np.zeros(1, LOAD_SPREAD))
        self.drives = ffi.from_buffer("struct load_ratio[]", self.ratios)
        self.n = n
        lib.load_reference_reset(self.all, self.drives, n, spread)

    @property
    def spread(self):
        return self.all.spread

    @property
    def ratio(self):
        return self.ratios["ratio"]

    @property
    def variance(self):
        return self.ratios["variance"]

    def observe(self, load, common, known, healthy, *, relative=True):
        """Spread, then ratios."""
        self.watch(load, common, known, relative=relative)
        self.learn(load, common, healthy, relative=relative)

    def watch(self, load, common, known, *, relative=True):
        seen = self._observed(load, common, known, known)
        lib.update_spread(self.all, self.drives, seen, self.n, relative)

    def learn(self, load, common, healthy, *, relative=True):
        seen = self._observed(load, common, healthy, healthy)
        lib.update_ratios(self.all, self.drives, seen, self.n, relative)

    def _observed(self, load, common, known, healthy):
        made = np.zeros(self.n, LOAD_OBSERVATION)
        made["load"], made["common"], made["known"], made["healthy"] = load, common, known, healthy
        return ffi.from_buffer("struct load_observation[]", made)

    def normalised(self, load, share=None, transient=0.0):
        """(N,) loads as if the drives were equal, and their sigma."""
        share = np.ones(self.n) if share is None else share
        rows = [
            (
                lib.normalise_load(self.drives + k, load[k], share[k]),
                lib.normalised_sigma(self.all, self.drives + k, load[k], share[k], transient),
            )
            for k in range(self.n)
        ]
        return np.array(rows).T


class Responses(Loads):
    """The same of loads over commands: `estimators/detect/command_response.c`."""

    def __init__(self, n, spread):
        super().__init__(n, spread)
        self.records = np.zeros(n, COMMAND_RESPONSE)
        self.each = ffi.from_buffer("struct command_response[]", self.records)

    def hear(self, heard):
        """Everything but how long deficits have stood."""
        one = self.records
        one["load"], one["acceleration_torque"] = heard.load, heard.excess
        one["braked_load"] = heard.braked
        one["command"], one["previous_command"] = heard.command, heard.before
        one["command_age_s"], one["usable"] = heard.age_s, heard.usable

    def respond(self, heard, dt):
        """(N,) probabilities, and where they are valid."""
        self.hear(heard)
        valid = np.full(self.n, 7, dtype=np.uint8)
        at = ffi.from_buffer("uint8_t[]", valid)
        lost = [
            lib.respond(self.each + k, self.all, self.drives + k, dt, at + k) for k in range(self.n)
        ]
        assert set(valid) <= {0, 1}
        return np.array(lost), valid.astype(bool)

    def learn_response(self, heard, healthy, dt):
        self.hear(heard)
        workspace = ffi.new("struct load_observation[]", self.n)
        lib.learn_responses(
            self.each, self.all, self.drives, ffi.from_buffer("uint8_t[]", healthy), self.n, dt,
            workspace,
        )  # fmt: skip

    def fuse(self, heard, compared, alone, away, valid):
        """(N,) probabilities, and where they are known."""
        self.hear(heard)
        lost = [
            lib.fuse_loss(self.each + k, compared.lost[k], compared.known[k], alone[k], valid[k],
                          away[k])
            for k in range(self.n)
        ]  # fmt: skip
        asked = [lib.is_asked(self.each + k) for k in range(self.n)]
        return np.array(lost), compared.known | np.array(asked, dtype=bool)

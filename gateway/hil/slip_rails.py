"""The rails of the slip-protection bench, and tracks drawn by seed.

The test cases follow EN 15595:2018+A1:2023 (low adhesion all the way or on a stretch, a film that
breaks through, wheels of unequal diameter, wheel rotation monitoring, a degraded axle) and UIC
541-05 (utilisation of the available adhesion). The standards' trains, speeds and friction values
are not used: the train is a model (sim/physics/plant.py), and the adhesion curves are Polach's.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from sim.physics.adhesion import RAILS, Rail

AXLES: Final = 4
AXLE_M: Final = 2.5
"""Distance between two axles, which reach a stretch one after the other."""
DRY: Final = RAILS["dry"]
WET: Final = RAILS["wet"]._replace(mu_0=0.16)
"""Peak 0.12: below the traction coefficient demanded; Polach's own wet rail is above it."""
SOAP: Final = Rail(0.12, 0.45, 0.25, 0.30, 0.12)
LEAVES: Final = RAILS["leaves"]
SPREAD: Final = (0.85, 1.15)
"""Range of a seeded track's friction, relative to the library's."""
NEVER: Final = -1
"""No axle."""


class Track(NamedTuple):
    """One run of the bench.

    stretches: (start along the track in m, rail); wheel: diameters relative to the nominal one;
    stuck: the axle (from 0) whose torque ignores the controller, cut_out: the one without torque;
    film_j: sliding work, in J per kg of wheel load, that removes 63 % of the film, None: nothing
    removes it; asked: traction coefficient that the brake demands.
    """

    name: str
    title: str
    stretches: tuple[tuple[float, Rail], ...]
    wheel: tuple[float, ...] = (1.0,) * AXLES
    stuck: int = NEVER
    cut_out: int = NEVER
    film_j: float | None = None
    asked: float = 0.15
    of_peak: float | None = None
    """If given, the brake demands this share of the rail's peak at every speed, not `asked`."""

    def rail_at(self, way_m: float) -> Rail:
        """The rail at this position."""
        return next(rail for start, rail in reversed(self.stretches) if way_m >= start)


def _one(rail: Rail) -> tuple[tuple[float, Rail], ...]:
    return ((-np.inf, rail),)


_PATCH: Final = ((-np.inf, WET), (25.0, LEAVES), (45.0, WET))
LIBRARY: Final[dict[str, Track]] = {
    track.name: track
    for track in (
        Track("dry", "dry rail: nothing to protect from", _one(DRY)),
        Track("wet", "wet rail all the way", _one(WET)),
        Track("soap", "soap solution, from 25 m on", ((-np.inf, WET), (25.0, SOAP))),
        Track("leaves", "20 m of leaves on wet rail", _PATCH),
        Track("film", "leaves, a film that breaks through", _one(LEAVES), film_j=15.0),
        Track("small_wheel", "wheel 4 is 3 % smaller, leaves", _PATCH, (1.0, 1.0, 1.0, 0.97)),
        Track("rotation", "wheel rotation monitoring: axle 3 ignores the controller", _one(WET),
              stuck=2),
        Track("degraded", "degraded: axle 2 is cut out", _PATCH, cut_out=1),
    )
}  # fmt: skip


def held(of_peak: float, seed: int = 0) -> Track:
    """A wet track, its friction drawn by seed, on which the demand is a share of the peak."""
    rng = np.random.default_rng([seed, round(1000 * of_peak)])
    rail = WET._replace(mu_0=WET.mu_0 * float(rng.uniform(*SPREAD)))
    return Track(f"held_{of_peak:g}", f"{100 * of_peak:g} % of the peak", _one(rail),
                 of_peak=of_peak)  # fmt: skip


def seeded(seed: int) -> Track:
    """A track of three stretches with friction, positions, rails and wheels drawn by seed."""
    rng = np.random.default_rng([seed, 15595])
    kinds = [(WET, SOAP, LEAVES)[k] for k in rng.choice(3, 3, replace=False)]
    places = (-np.inf, float(rng.uniform(15.0, 30.0)), float(rng.uniform(40.0, 60.0)))
    rails = [kind._replace(mu_0=kind.mu_0 * float(rng.uniform(*SPREAD))) for kind in kinds]
    wheel = tuple(rng.uniform(0.985, 1.015, AXLES).tolist())
    return Track(f"seed_{seed}", f"track of seed {seed}",
                 tuple(zip(places, rails, strict=True)), wheel)  # fmt: skip

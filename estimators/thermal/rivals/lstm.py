"""Long short-term memory network (Hochreiter, Schmidhuber 1997): paper `thermal`, Table 2.

It predicts all temperatures from the recent course of the inputs; the statistic is the norm of the
residual. Derivatives are autograd's; nothing here imports it before `fit`.

With `others` it exploits that the motors are alike.
Tried on seeds 0, 3, 6, 9: 2 to 6 steps, reach 1.5 or 5 %, 8 to 32 units, decay 0 to 0.01, with and
without `others` and `joint`, means of 2 or 5 %; 3 steps of 32 units won, by little.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dbc.arrays import Array
from estimators.thermal.record import Record
from estimators.thermal.rivals.dpca import Scorer, span, usual
from estimators.thermal.rivals.jitl import Norm, rises


class Weights(NamedTuple):
    """Weights of the network.

    gates (I + H + 1, 4 H): rows of the inputs, of the last output and of 1; columns of the input,
    forget and output gates, and of the candidate value. out (H + 1, T).
    """

    gates: Array
    out: Array


@dataclass(frozen=True)
class Lstm:
    """Tuning of the network.

    steps: length of a sequence; reach: share of the run's samples that it goes back; hidden: units;
    rate, epochs: of Adam; decay: of the weights; others: whether what is predicted is the
    difference to the other motors' median; joint: as in `Jitl`; window: share of the run's samples
    over which residuals are averaged; most: sequences learnt from; seed: of the start weights.
    """

    steps: int = 3
    reach: float = 0.015
    hidden: int = 32
    rate: float = 0.01
    decay: float = 1e-2
    epochs: int = 250
    others: bool = True
    joint: bool = True
    window: float = 0.02
    most: int = 720
    seed: int = 0
    name: str = "lstm"

    def fit(self, healthy: Record) -> Scorer:
        """Learn from one fault-free run.

        Raises ModuleNotFoundError without autograd, ValueError if the run has fewer than 10 samples
        after the first sequence.
        """
        stride = max(round(self.reach * len(healthy.at) / self.steps), 1)
        early = stride * (self.steps - 1)
        if len(healthy.at) - early < 10:
            raise ValueError(f"{len(healthy.at)} samples are too few")
        start = usual(healthy.temperature)
        inputs, targets = rises(healthy, start, self.others)
        scaled, centre = _standard(inputs), _standard(targets)
        every = -(-(len(inputs) - early) // self.most)
        rows = np.arange(early, len(inputs), every)

        def sequences(inputs: Array, rows: Any) -> Array:
            back = rows[:, None] - stride * np.arange(self.steps - 1, -1, -1)
            return np.asarray(((inputs - scaled[0]) / scaled[1])[back])

        learnt = self._learn(sequences(inputs, rows), (targets[rows] - centre[0]) / centre[1])

        def residual(inputs: Array, targets: Array, rows: Any) -> Array:
            guess = predict(learnt, sequences(inputs, rows))
            return np.asarray((targets[rows] - centre[0]) / centre[1] - guess)

        window = span(healthy, self.window)
        own = residual(inputs, targets, rows)
        norm = Norm.of(own, max(round(window / every), 1), window, self.joint)

        def score(record: Record) -> Array:
            inputs, targets = rises(record, start, self.others)
            out = np.full(len(inputs), np.nan)
            if len(inputs) > early:
                rows = np.arange(early, len(inputs))
                out[early:] = norm(residual(inputs, targets, rows))
            return out

        return score

    def _learn(self, x: Array, y: Array) -> Weights:
        """The weights with the least error on the last fifth, which is held out of the learning."""
        from autograd import grad
        from autograd.misc.optimizers import adam

        split = len(x) - len(x) // 5
        start = weights(np.random.default_rng(self.seed), x.shape[2], self.hidden, y.shape[1])
        best, least = start, np.inf

        def loss(learnt: Any, _epoch: int) -> Any:
            decay = sum((part**2).sum() for part in learnt)
            return mean_square(learnt, x[:split], y[:split]) + 0.5 * self.decay * decay

        def keep(learnt: Any, _epoch: int, _slope: Any) -> None:
            nonlocal best, least
            held_back = float(mean_square(learnt, x[split:], y[split:]))
            if held_back < least:
                best, least = Weights(*learnt), held_back

        adam(grad(loss), tuple(start), keep, self.epochs, self.rate)
        return best


def weights(rng: np.random.Generator, inputs: int, hidden: int, outputs: int) -> Weights:
    """Start weights of a network: uniform, within 1 / sqrt(hidden)."""
    most = hidden**-0.5
    return Weights(
        rng.uniform(-most, most, (inputs + hidden + 1, 4 * hidden)),
        rng.uniform(-most, most, (hidden + 1, outputs)),
    )


def mean_square(learnt: tuple[Array, Array], x: Array, y: Array) -> Any:
    """Mean square error of all outputs y (B, T) for sequences x (B, steps, I)."""
    return ((predict(Weights(*learnt), x) - y) ** 2).mean()


def predict(learnt: Weights, x: Array) -> Any:
    """(B, T) outputs for sequences x (B, steps, I)."""
    import autograd.numpy as anp

    ones = np.ones((len(x), 1))
    hidden = learnt.out.shape[0] - 1
    output = cell = np.zeros((len(x), hidden))
    for step in range(x.shape[1]):
        sums = anp.dot(anp.concatenate([x[:, step], output, ones], axis=1), learnt.gates)
        opened = 0.5 * (anp.tanh(0.5 * sums[:, : 3 * hidden]) + 1.0)
        entry, keep, show = (opened[:, k * hidden : (k + 1) * hidden] for k in range(3))
        cell = keep * cell + entry * anp.tanh(sums[:, 3 * hidden :])
        output = show * anp.tanh(cell)
    return anp.dot(anp.concatenate([output, ones], axis=1), learnt.out)


def _standard(values: Array) -> tuple[Array, Array]:
    return values.mean(axis=0), np.maximum(values.std(axis=0), 1e-3)

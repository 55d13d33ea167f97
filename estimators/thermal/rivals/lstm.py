"""Long short-term memory network (Hochreiter, Schmidhuber 1997): paper `thermal`, Table 2.

It predicts all temperatures from the recent course of the inputs; the statistic is the norm of the
residual. Needs torch; nothing here imports it before `fit`.

With `others` it knows that the motors are alike.
Tried on seeds 0, 3, 6, 9: 2 to 6 steps, reach 1.5 or 5 %, 8 to 32 units, decay 0 to 0.01, with and
without `others` and `joint`, means of 2 or 5 %; 3 steps of 32 units won, by little.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimators.thermal.record import Array, Record
from estimators.thermal.rivals.dpca import Scorer, span, usual
from estimators.thermal.rivals.jitl import Norm, rises


@dataclass(frozen=True)
class Lstm:
    """Tuning of the network.

    steps: of a sequence; reach: share of the run's samples that it goes back; hidden: units;
    rate, decay: of Adam; epochs, patience: at most, and without a better last fifth; others:
    whether what is predicted is the difference to the other motors' median; joint: as in `Jitl`;
    window: share of the run's samples over which residuals are averaged; most: sequences learnt
    from; seed: of the start weights.
    """

    steps: int = 3
    reach: float = 0.015
    hidden: int = 32
    rate: float = 0.01
    decay: float = 1e-2
    epochs: int = 250
    patience: int = 25
    others: bool = True
    joint: bool = True
    window: float = 0.02
    most: int = 720
    seed: int = 0
    name: str = "lstm"

    def fit(self, healthy: Record) -> Scorer:
        """Learn from one fault-free run.

        ModuleNotFoundError without torch, ValueError if the run has fewer than 10 samples after
        the first sequence.
        """
        torch = _torch()
        stride = max(round(self.reach * len(healthy.at) / self.steps), 1)
        early = stride * (self.steps - 1)
        if len(healthy.at) - early < 10:
            raise ValueError(f"{len(healthy.at)} samples are too few")
        start = usual(healthy.temperature)
        inputs, targets = rises(healthy, start, self.others)
        scaled, centre = _standard(inputs), _standard(targets)
        every = -(-(len(inputs) - early) // self.most)
        rows = np.arange(early, len(inputs), every)

        def sequences(inputs: Array, rows: Any) -> Any:
            back = rows[:, None] - stride * np.arange(self.steps - 1, -1, -1)
            return torch.as_tensor(((inputs - scaled[0]) / scaled[1])[back], dtype=torch.float32)

        wanted = torch.as_tensor((targets[rows] - centre[0]) / centre[1], dtype=torch.float32)
        model = self._learn(torch, sequences(inputs, rows), wanted)

        def residual(inputs: Array, targets: Array, rows: Any) -> Array:
            with torch.no_grad():
                guess = model(sequences(inputs, rows)).double().numpy()
            return np.asarray((targets[rows] - centre[0]) / centre[1] - guess)

        window = span(healthy, self.window)
        own = residual(inputs, targets, rows)
        norm = Norm.of(own, max(round(window / every), 1), window, self.joint)

        def score(record: Record) -> Array:
            inputs, targets = rises(record, start, self.others)
            out = np.full(len(inputs), np.nan)
            if len(inputs) > early:
                rows = np.arange(early, len(inputs))
                out[early:] = norm(_alone(torch, lambda: residual(inputs, targets, rows)))
            return out

        return score

    def _learn(self, torch: Any, x: Any, y: Any) -> Any:
        """The network that did best on the last fifth, which it has not learnt from."""

        def run() -> Any:
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(self.seed)
                model = _network(torch, x.shape[2], self.hidden, y.shape[1])
            adam = torch.optim.Adam(model.parameters(), lr=self.rate, weight_decay=self.decay)
            split = len(x) - len(x) // 5
            best, best_loss, since = model.state_dict(), np.inf, 0
            for _ in range(self.epochs):
                adam.zero_grad()
                torch.mean((model(x[:split]) - y[:split]) ** 2).backward()
                adam.step()
                with torch.no_grad():
                    loss = float(torch.mean((model(x[split:]) - y[split:]) ** 2))
                since += 1
                if loss < best_loss:
                    best_loss, since = loss, 0
                    best = {key: value.clone() for key, value in model.state_dict().items()}
                if since > self.patience:
                    break
            model.load_state_dict(best)
            return model.eval()

        return _alone(torch, run)


def _torch() -> Any:
    try:
        return importlib.import_module("torch")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "the LSTM needs torch: pip install torch", name="torch"
        ) from error


def _alone(torch: Any, run: Any) -> Any:
    """Run on one thread, so that sums come out the same on every machine's number of cores."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return run()
    finally:
        torch.set_num_threads(threads)


def _network(torch: Any, inputs: int, hidden: int, outputs: int) -> Any:
    class Network(torch.nn.Module):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self.cells = torch.nn.LSTM(inputs, hidden, batch_first=True)
            self.out = torch.nn.Linear(hidden, outputs)

        def forward(self, x: Any) -> Any:
            return self.out(self.cells(x)[0][:, -1])

    return Network()


def _standard(values: Array) -> tuple[Array, Array]:
    return values.mean(axis=0), np.maximum(values.std(axis=0), 1e-3)

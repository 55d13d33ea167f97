"""`check --forecast`: the smallest loss of adhesion that will be found in time."""

from __future__ import annotations

from pathlib import Path

from dbc.codec import Codec
from gateway.commands.progress import Progress
from gateway.hil import forecast_table
from gateway.hil.forecast_table import WITHIN_MS, Cell
from gateway.io.extras import pictures
from gateway.settings.config import Config


def print_table(config: Config, codec: Codec, rated_rpm: float, output: Path | None) -> list[str]:
    """Print the table and write the files; return the motors with no loss that will be found."""
    if output is not None:
        pictures("--output")
    with Progress("forecast", len(forecast_table.SPEEDS) * len(forecast_table.TORQUES)) as bar:
        cells = forecast_table.cells(config, codec, rated_rpm, bar.advance)
    if len(same := {cell.problem for cell in cells}) == 1 and (problem := same.pop()):
        print(f"forecast       none: {problem}")
        return [problem]
    print(
        "forecast       smallest loss of one drive, % of its load, that is found in 9 of 10 cases"
    )
    print(f"{'':<15}within 50 ms and within 200 ms, at a steady speed and torque")
    problems = []
    for nodes in dict.fromkeys(cell.nodes for cell in cells):
        mine = [cell for cell in cells if cell.nodes == nodes]
        drives = f"drive{'s' if len(nodes) > 1 else ''} {', '.join(map(str, nodes))}"
        print(f"  {drives}, motor {mine[0].motor}")
        print(f"  {'speed':>10} {'torque':>8}   {'50 ms':>7} {'200 ms':>7}")
        for cell in mine:
            print(f"  {cell.rpm:6.0f} rpm {100 * cell.torque:6.0f} %   {_losses(cell, WITHIN_MS)}")
        if not any(cell.smallest(WITHIN_MS[-1]) for cell in mine):
            why = mine[-1].problem or f"every loss takes longer than {WITHIN_MS[-1]} ms"
            problems.append(f"{drives}: {why}")
    print(f"{'':<15}A smaller loss is found later or never: its flag stays Adhering.")
    if output is not None:
        for path in forecast_table.write_forecast(output, cells):
            print(f"{'':<15}written: {path}")
    return problems


def _losses(cell: Cell, limits_ms: tuple[int, ...]) -> str:
    if cell.problem:
        return f"not judged: {cell.problem}"
    losses = [cell.smallest(within_ms) for within_ms in limits_ms]
    return " ".join(f"{f'{100 * loss:.0f} %' if loss else 'none':>7}" for loss in losses)

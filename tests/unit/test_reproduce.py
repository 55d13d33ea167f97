"""`reproduce adhesion`: Table 1 by hand, the same world with and without a bus, files, bytes."""

import csv
import io
import re
from contextlib import redirect_stderr, redirect_stdout

import numpy as np
import pytest

from dbc.candump.reader import Reader
from dbc.codec import bind
from estimators.models import pmsm
from gateway.cli import main
from gateway.commands import reproduce, section5
from gateway.settings.config import shipped_dbc
from gateway.study import reproduction as table_1
from gateway.study import reproduction_loads as bench
from gateway.study import reproduction_paths as paths
from gateway.study import reproduction_variants as variants
from gateway.study.reproduction_figures import thinned
from sim.scenario import builtin
from sim.simulation import Simulation
from tests.reference import ekf
from tests.simrun import FD_FILE, codec, values

SHORT_S = 0.4


@pytest.fixture(scope="module")
def scenario():
    return builtin(section5.NAME).model_copy(update={"duration_s": SHORT_S})


@pytest.fixture(scope="module")
def world(scenario):
    return section5.simulate(scenario)


@pytest.fixture(scope="module")
def made(scenario, tmp_path_factory):
    """A whole run of 0.4 s, and what it says."""
    here, out, err = tmp_path_factory.mktemp("reproduce") / "new", io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr("sim.scenario.builtin", lambda _name: scenario)
        patch.setattr(reproduce.reproduce, "__defaults__", ((6, 7),))
        assert main(["reproduce", "adhesion", "-o", str(here)]) == 0
    return here, out.getvalue(), err.getvalue()


@pytest.fixture(scope="module")
def folder(made):
    return made[0]


def test_statistics_by_hand():
    found = table_1.statistics(np.array([7.0, -3.0, 0.0, 2.0, -1.0]))
    s = np.sqrt((36 + 16 + 1 + 1 + 4) / 4)
    assert found == pytest.approx([-3, -1, 0, 2, 7, 1, s, 3])
    # Between the samples quartiles are interpolated.
    assert table_1.statistics(np.array([0.0, 1.0]))[[1, 2, 3, 7]] == pytest.approx(
        [0.25, 0.5, 0.75, 0.5]
    )
    with pytest.raises(ValueError, match="two samples"):
        table_1.statistics(np.array([1.0]))


def test_table_of_the_median_by_hand():
    load = np.array([[1.0, 2.0, 3.0], [4.0, 4.0, 0.0], [9.0, 5.0, 5.0]])
    found = table_1.table(load)
    row = list(table_1.METHODS).index("median")
    # Medians 2, 4, 5: differences -1 0 1, 0 0 -4, 4 0 0.
    mean, s = 1.0, np.sqrt((4 + 1 + 9) / 2)
    assert found.value[row, 0] == pytest.approx([-1, -0.5, 0, 2, 4, mean, s, 2.5])
    assert found.value[row, 1] == pytest.approx(np.zeros(8))
    assert found.at[row].tolist() == [[0, 2], [0, 0], [1, 0]]


def test_prior_strength_one_is_the_table():
    rng = np.random.default_rng(3)
    load = 10.0 + 0.1 * rng.standard_normal((400, 3))
    load[100:200, 0] -= 4.0
    rows = dict(table_1.prior_strengths(load))
    assert rows[1.0] == pytest.approx(table_1.table(load).value[0, 1])
    # The weaker the prior, the further the mean follows the drive that reads less.
    means = [rows[beta][5] for beta in sorted(rows)]
    assert means == sorted(means, reverse=True)
    assert means[0] > means[-1] + 0.05


def test_networks_equal_the_central_unit_and_say_what_it_costs():
    rng = np.random.default_rng(5)
    load = 15.0 + 0.3 * rng.standard_normal((100, 3))
    load[40:, 1] -= 12.0
    found = variants.networks_of(load)
    assert len(found) == 8
    assert {(r.network, r.exchange, r.nodes) for r in found} == {
        (n, e, k) for n in ("ring", "tree") for e in ("tree", "consensus") for k in (3, 15)
    }
    assert all(r.apart < 1e-6 for r in found)
    # Five sweeps up and down a spanning tree, 2 (N - 1) each, and what the set-up costs.
    assert all(
        10 * (r.nodes - 1) < r.messages <= 16 * (r.nodes - 1) for r in found if r.exchange == "tree"
    )


def test_a_cell_agrees_within_its_tolerance_or_says_why():
    printed = np.array(list(table_1.PRINTED.values()))
    same = table_1.Table(printed.copy(), np.zeros((4, 3, 2), dtype=np.int64))
    cells = table_1.compare(same, same, zero_locked=True)
    assert len(cells) == 96
    assert all(c.agrees and not c.reason and c.difference == 0.0 for c in cells)

    off = table_1.Table(printed + 0.021, same.at)
    wrong = [c for c in table_1.compare(off, off, zero_locked=True) if not c.agrees]
    assert not wrong  # 0.021 is 0.02 when printed
    off = table_1.Table(printed + 0.03, same.at)
    wrong = [c for c in table_1.compare(off, same, zero_locked=True) if not c.agrees]
    assert {c.statistic for c in wrong} == set(table_1.QUARTILES)
    assert {c.reason for c in wrong} == {table_1.ZERO_START}
    # A wrong lock explains nothing, whatever its numbers.
    wrong = [c for c in table_1.compare(off, same, zero_locked=False) if not c.agrees]
    assert {c.reason for c in wrong} == {table_1.SPREAD}

    far = table_1.Table(printed * 1.06 - 0.101, same.at)
    cells = table_1.compare(far, far, zero_locked=True)
    assert all(c.reason for c in cells if not c.agrees)
    assert not any(c.reason for c in cells if c.agrees)
    lowest = next(c for c in cells if c.method == "vmp" and c.drive == 1 and c.statistic == "Min")
    assert (lowest.agrees, lowest.at) == (False, 1)
    assert lowest.difference == pytest.approx(-21.36 * 0.06 - 0.101, abs=0.01)


def test_loads_equal_the_plain_filter(world):
    samples = section5.measure(world, 16, 3, (0.02, 0.1))
    found = bench.estimate(samples, bench.PRODUCT, *bench.unit_start(world.start))
    n = len(world.start)
    par = pmsm.repeat(pmsm.BENCH_MOTOR, n)
    R = np.full((n, 2), bench.PRODUCT.R + 0.02**2 / 12)
    noise = pmsm.Noise(np.tile(bench.PRODUCT.Q, (n, 1)), R, np.zeros(n))
    x, P = bench.unit_start(world.start.copy())
    drive, one = np.arange(n, dtype=np.int32), np.ones(n, dtype=np.int64)
    for k in range(40):
        ekf.sweep(par, noise, x, P, drive, samples.u[k], samples.y[k], 16 * one, 0 * one, 125e-6)
        assert found.load[k] == pytest.approx(x[:, pmsm.T_L], rel=1e-9)
        assert found.speed[k] == pytest.approx(x[:, pmsm.W_E], rel=1e-9)


def test_the_start_is_not_changed_by_the_filter(world):
    before = world.start.copy()
    section5.without_bus(world)
    assert (world.start == before).all()


def test_a_filter_that_diverges_is_said(world):
    samples = section5.measure(world, 1, 2, (0.0, 0.0))
    samples.y[7] = np.inf
    with pytest.raises(FloatingPointError, match="sample 8"):
        bench.estimate(samples, bench.PAPER, *bench.unit_start(world.start))


def test_the_plant_is_the_simulators(scenario, world):
    simulation = Simulation(scenario, codec())
    simulation.step((), round(SHORT_S * 1e9))
    rows = simulation.truth_rows()
    assert len(rows) == 3 * round(SHORT_S * 100)
    for row in rows:
        k = round(row.t_s * 8000) - 1
        assert world.load[k, row.drive - 1] == pytest.approx(row.load_nm, abs=1e-12)
        assert world.speed[k, row.drive - 1] == pytest.approx(4 * row.speed_rad_s, abs=1e-9)
    first = section5.simulate(scenario.model_copy(update={"duration_s": 125e-6}))
    assert world.start[:, 3] + world.start[:, 2] * 125e-6 == pytest.approx(
        first.rows[0, :, section5.columns.ANGLE], abs=1e-3
    )


def test_without_a_bus_the_samples_are_those_on_the_bus(folder, world):
    steps = section5.wire_steps(section5.BUSES[1])
    assert steps == (0.02, 0.1)
    samples = section5.measure(world, section5.SLOW, 3, steps)
    frames = list(Reader(folder / "section5_classic.log"))
    for d in (1, 2, 3):
        amps = values(frames, f"Drive{d}_PhaseCurrents")
        volts = values(frames, f"Drive{d}_StatorVoltages")
        alpha = [(2 * a["Ia"] - a["Ib"] - a["Ic"]) / 3 for a in amps]
        assert len(alpha) > 190
        assert samples.y[: len(alpha), d - 1, 0] == pytest.approx(np.array(alpha), abs=1e-9)
        u = [v["Ubeta"] for v in volts]
        assert samples.u[: len(u), d - 1, 1] == pytest.approx(np.array(u), abs=1e-9)


def test_the_same_on_fd(folder, world):
    steps = section5.wire_steps(section5.BUSES[0])
    assert steps == (0.05, 0.25)
    samples = section5.measure(world, 1, 2, steps)
    fd = bind(FD_FILE, (1, 2, 3))
    rows = values(list(Reader(folder / "section5_fd.log")), "Drive2_Samples", fd)
    a = np.array([[r[f"Ia_{k}"] for k in range(8)] for r in rows]).ravel()
    b = np.array([[r[f"Ib_{k}"] for k in range(8)] for r in rows]).ravel()
    assert len(a) > 3000
    assert samples.y[: len(a), 1, 0] == pytest.approx(a, abs=1e-9)
    assert samples.y[: len(a), 1, 1] == pytest.approx((a + 2 * b) / np.sqrt(3), abs=1e-9)


def test_an_instant_sees_the_last_estimate_there_was():
    course = paths.Course("8 kHz", "", np.array([1000, 2000]), np.array([[1.0], [2.0]]))
    seen = paths.at(course, np.array([999, 1000, 1999, 2000, 9000]))
    assert np.isnan(seen[0, 0])
    assert seen[1:, 0].tolist() == [1.0, 1.0, 2.0, 2.0]


def test_the_delay_of_a_bus_is_found():
    t_ns = np.arange(1, 4001) * 125_000
    load = np.cumsum(np.random.default_rng(1).standard_normal((4000, 3)), axis=0)
    ways = [
        paths.Course(way.name, "f", t_ns + (1_000_000 if way.name.endswith("bus") else 0), load)
        for way in paths.WAYS
    ]
    truth = paths.Course("truth", "", t_ns, load)
    found = paths.compare(ways, truth)
    assert {(d.age_ns, d.rest_nm) for d in found.delays} == {(1_000_000.0, 0.0)}
    assert found.of("8 kHz", "f").rmse == pytest.approx(np.zeros(3))
    assert (found.of("FD bus", "f").rmse > 1.0).all()
    # No drive known at any time on one way: nothing to compare.
    ways[0] = ways[0]._replace(load=np.full((4000, 3), np.nan))
    with pytest.raises(ValueError, match="hardly ever"):
        paths.compare(ways, truth)


def test_thinning_keeps_the_extremes():
    t_s = np.arange(10_000.0)
    noise = np.random.default_rng(2).standard_normal(10_000)
    noise[4321] = 50.0
    at, thin = thinned(t_s, noise, 100)
    assert len(at) < 250
    assert (thin.max(), thin.min()) == (50.0, noise.min())
    assert (np.diff(at) > 0).all()
    assert (noise[at.astype(int)] == thin).all()


def test_files_and_the_table_in_them(folder):
    rows = list(csv.DictReader((folder / "table1.csv").read_text().splitlines()))
    assert len(rows) == 96
    assert all((r["agrees"] == "yes") == (r["reason"] == "") for r in rows)
    for name in ("figure5", "figure6", "figure7", "figure8", "figure9"):
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert b"<svg" in (folder / f"{name}.svg").read_bytes()[:2000]
    text = (folder / "report.md").read_text()
    cell = next(r for r in rows if r["statistic"] == "s" and r["method"] == "k-means")
    line = next(x for x in text.splitlines() if x.startswith("| k-means.PMSM1 "))
    assert cell["ours_nm"] in line
    assert "(6.29)" in line
    assert "Only the first 0.4 s" in text
    assert "--seed 5" in text
    for r in rows:
        assert r["agrees"] == "yes" or r["reason"] in text


def test_the_page_stands_alone(folder):
    page = (folder / "report.html").read_text()
    sources = re.findall(r'src="([^"]*)"', page)
    assert len(sources) == 5
    assert all(s.startswith("data:image/svg+xml;base64,") for s in sources)
    assert "href=" not in page
    assert page.count("<table>") >= 6
    assert "<td>k-means.PMSM1</td>" in page


def test_paths_table_holds_every_way_and_filter(folder):
    rows = list(csv.DictReader((folder / "table1_paths.csv").read_text().splitlines()))
    assert len(rows) == len(paths.WAYS) * 2 * 96
    assert {r["filter"] for r in rows} == {"paper's Q", "product's Q"}
    # In the first window drive 1 carries nothing of its 10 Nm, on every way.
    lowest = [float(r["value_nm"]) for r in rows
              if (r["method"], r["drive"], r["statistic"]) == ("median", "1", "Min")]  # fmt: skip
    assert len(lowest) == 12
    assert all(-12.0 < v < -9.5 for v in lowest)


def test_the_command_says_what_agrees(made):
    _, out, err = made
    assert "VMP.PMSM3" in out
    assert re.search(r"\d+ of 48 quartiles agree .*, \d+ of 48 other .*, \d+ of 96\n", out)
    assert re.fullmatch(r"done in \d+ s\n", err)


def test_another_seed_is_another_run(scenario):
    other = section5.simulate(scenario.model_copy(update={"seed": 6}))
    one = section5.simulate(scenario)
    assert not np.allclose(one.start[:, 3], other.start[:, 3])


@pytest.mark.parametrize(
    "words",
    [["weather", "-o", "x"], ["thermal"], ["adhesion"], ["adhesion", "-o", "x", "--seed", "-1"]],
)
def test_what_is_not_there_is_refused(words, capsys):
    with pytest.raises(SystemExit) as refused:
        main(["reproduce", *words])
    assert refused.value.code == 2
    assert "error" in capsys.readouterr().err


def test_shipped_files_are_found():
    assert {b.dbc for b in section5.BUSES} == {"traction.dbc", "traction_fd.dbc"}
    assert all(shipped_dbc(b.dbc).is_file() for b in section5.BUSES)

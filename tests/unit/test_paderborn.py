"""The thermal model on recordings in the form of the Paderborn ones, of a motor made up here."""

import numpy as np
import pytest

from tests.programs import ended

HEAD = (
    "u_q,coolant,stator_winding,u_d,stator_tooth,motor_speed,i_d,i_q,pm,stator_yoke,ambient,"
    "torque,profile_id"
)


def profile(number, rng, samples=2400):
    """(K, 13) rows of a stator of three parts in a water jacket, and a rotor in an air gap."""
    hold = 240
    blocks = -(-samples // hold)
    i_q = np.repeat(rng.uniform(-200.0, 200.0, blocks), hold)[:samples]
    i_d = np.repeat(rng.uniform(-100.0, 0.0, blocks), hold)[:samples]
    rpm = np.repeat(rng.uniform(0.0, 5000.0, blocks), hold)[:samples]
    coolant = rng.uniform(18.0, 60.0) + np.zeros(samples)
    winding = tooth = yoke = rotor = coolant[0]
    parts = np.empty((samples, 4))
    for k in range(samples):
        copper = 4e-6 * (i_d[k] ** 2 + i_q[k] ** 2) * (1.0 + 0.0039 * (winding - 60.0))
        iron, gap = 6e-9 * rpm[k] ** 2, 4e-4 * (tooth - rotor)
        parts[k] = winding, tooth, yoke, rotor
        winding += 0.5 * (copper - 0.01 * (winding - tooth))
        tooth += 0.5 * (iron + 0.004 * (winding - tooth) - 0.006 * (tooth - yoke) - gap)
        yoke += 0.5 * (0.006 * (tooth - yoke) - 0.008 * (yoke - coolant[k]))
        rotor += 0.5 * (gap + 0.15 * iron)
    winding, tooth, yoke, rotor = parts.T
    zero = np.zeros(samples)
    return np.stack(
        [zero, coolant, winding, zero, tooth, rpm, i_d, i_q, rotor, yoke, coolant, zero,
         np.full(samples, number)], axis=1,
    )  # fmt: skip


@pytest.fixture(scope="module")
def recordings():
    rng = np.random.default_rng(7)
    return {number: profile(number, rng) for number in (2, 4, 5, 6, 60, 62, 74)}


def run(path, rows):
    np.savetxt(path, np.concatenate(rows), delimiter=",", header=HEAD, comments="", fmt="%.6g")
    return ended("-m", "bench.paderborn", path)


def test_it_learns_from_some_profiles_and_is_judged_on_the_three_of_the_literature(
    tmp_path, recordings
):
    done = run(tmp_path / "measures_v2.csv", list(recordings.values()))
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0] == "learning from 4 profiles, 1.3 h"
    all_four = next(line for line in lines if line.startswith("all four"))
    error = float(all_four.split("error ")[1].split()[0])
    judged = np.concatenate([recordings[number] for number in (60, 62, 74)])
    rises = judged[:, [2, 4, 8, 9]] - judged[:, [1]]
    assert error < 0.05 * np.mean(rises**2)


def test_a_file_without_the_judged_profiles_is_refused(tmp_path, recordings):
    done = run(tmp_path / "measures_v2.csv", [recordings[2]])
    assert done.returncode == 2
    assert "needs the profiles (60, 62, 74) and others" in done.stderr

"""A motor without current in a train that is judged by `maisd`: it is compared with no other."""

import pytest

from gateway.cli import main
from tests import slow_record
from tests.thorough import some


def compared(folder, capsys, motors, **idle):
    """Last words of a replay by `maisd`: seconds, drive, thermal state; and what it prints."""
    config = slow_record.config(folder, motors)
    slow_record.write(folder / "learnt.log", config, 1800, seed=1)
    slow_record.write(folder / "idle.log", config, 5400, seed=2, **idle)
    limits = folder / "limits.toml"
    learn = ["calibrate", str(folder / "learnt.log"), "--config", str(config), "-o", str(limits)]
    assert main([*learn, "--without-model"]) == 0
    lines = '[thermal]\nmethod = "maisd"\ncalibration = "limits.toml"\n'
    config.write_text(config.read_text() + lines)
    capsys.readouterr()
    assert main(["replay", str(folder / "idle.log"), "--config", str(config)]) == 0
    printed = capsys.readouterr()
    rows = [line.split() for line in printed.out.splitlines() if "  thermal  " in line]
    return [(float(t), int(node), word) for t, _, _, node, _, word in rows], "".join(printed)


@pytest.mark.parametrize(("motors", "out"), some([(3, (1, 2)), (3, (1,))], [(2, (2,))]))
def test_beside_a_cold_motor_no_driven_one_is_hot(tmp_path, capsys, motors, out):
    rows, printed = compared(tmp_path, capsys, motors, cut_out=out)
    known = {node for _, node, word in rows if word == "NoFault"}
    driven = set(range(1, motors + 1)) - set(out)
    assert "Fault" not in {word for *_, word in rows}
    assert known == (driven if len(driven) > 1 else set()), "one alone has none to compare with"
    assert "Config" in printed


def test_once_it_is_as_warm_as_the_others_it_is_compared_again(tmp_path, capsys):
    rows, _ = compared(tmp_path, capsys, 3, cut_out=(2,), until=1800)
    assert "Fault" not in {word for *_, word in rows}
    first = next(t for t, node, word in rows if node == 2 and word == "NoFault")
    assert 1800 < first < 5000

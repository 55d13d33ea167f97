"""What a start does not load: cryptography is for those who have a key, MF4 for who reads logs.

asammdf, pandas, pyarrow and the others are installed where these tests run.
"""

import gc
import importlib
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from gateway.cli import main
from gateway.io import quick_start
from gateway.io.console import console, note
from gateway.settings.config import ConfigError
from tests.programs import COMMAND, ended, gateway, loaded, printed

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "train.toml"
GOLDEN = ROOT / "tests" / "golden" / "loss.log.gz"
REPORTS = ("matplotlib", "markdown_it", "gateway.reports.reporting", "gateway.reports.trace",
           "gateway.reports.intervals", "gateway.reports.run_report",
           "gateway.reports.figures")  # fmt: skip
FLEET = ("dask", "distributed", "pyarrow")

RUN = ("run", "-i", "virtual", "-c", "lean", "--quiet", "--duration", "0.1")
WITHOUT_ASAMMDF = "sys.modules['asammdf'] = None; "
"""As `run` does it: python-can loads asammdf, and that pyarrow."""
IMPORTS = {
    "import gateway": ("numpy", "pydantic", "can"),
    "import estimators.detect as d; d.DETECTORS['vb']()": (
        "scipy.special", "scipy.cluster", "scipy.stats",
    ),
    WITHOUT_ASAMMDF + "import gateway.commands.fleet, gateway.commands.run": FLEET,
    WITHOUT_ASAMMDF + "import gateway.commands.replay, gateway.io.live, gateway.io.replay": FLEET,
}  # fmt: skip


@pytest.mark.parametrize("text", IMPORTS)
def test_who_only_imports_a_package_does_not_load(text):
    assert not loaded(IMPORTS[text], text)


def test_run_loads_no_cryptography_unless_something_is_authenticated(tmp_path):
    secret = ["cryptography"]
    assert not loaded(secret, COMMAND, *RUN, folder=tmp_path)
    config = tmp_path / "train.toml"
    config.write_text("[authentication]\n")
    words = *RUN, "--config", config
    assert not loaded(secret, COMMAND, *words, "--listen-only", folder=tmp_path)
    key = tmp_path / "auth.key"
    key.write_text("00112233445566778899aabbccddeeff")
    key.chmod(0o600)
    assert loaded(secret, COMMAND, *words, folder=tmp_path)
    assert (tmp_path / "trip").read_text() == "00000001\n"


HEAVY = ("asammdf", "pandas", "pyarrow", "matplotlib", "starlette", "textual", "scipy.linalg",
         "sklearn", "cantools", "cffi", "rich", "mcap")  # fmt: skip


def test_run_loads_nothing_for_logs_plots_pages_and_tables(tmp_path):
    assert all(map(find_spec, ("asammdf", "pandas", "pyarrow")))
    assert loaded((*HEAVY, *REPORTS, "can"), COMMAND, *RUN, folder=tmp_path) == ["can"]


def test_a_report_of_a_replay_needs_no_library_for_pictures(tmp_path):
    words = "replay", str(GOLDEN), "-o", "y.log", "--results", "results"
    assert not loaded(("matplotlib",), COMMAND, *words, folder=tmp_path)
    assert (tmp_path / "results" / "drive1.svg").is_file()


def test_mf4_is_read_and_written_in_a_program_that_started_on_a_bus(tmp_path):
    text = """
import sys
from pathlib import Path
from dbc.frames import block_of
from dbc.frame import Frame
from dbc.logs.opening import open_reader
from gateway.logfiles.mf4 import Mf4Frames
assert "asammdf" not in sys.modules
frames = [Frame(10**18 + k * 10**6, 0x100 + k, bytes([k] * 8)) for k in range(5)]
{order}
"""
    write = "sink = Mf4Frames(Path('x.mf4')); sink.add(block_of(frames)); sink.close()\n"
    read = (
        "read = open_reader(Path('x.mf4'), strict=False)\n"
        "print([(f.can_id, f.data) for f in read] == [f[1:3] for f in frames])"
    )
    for order in (write + read, read):  # the file is there for the second
        program = COMMAND + text.format(order=order)
        assert printed(f"import sys\n{program}", *RUN, folder=tmp_path)[-1] == "True"


def test_what_is_absent_for_a_while_is_there_again():
    with quick_start.absent("xdrlib_of_nobody", "json"):
        assert "json" in sys.modules, "what is loaded stays"
        with pytest.raises(ImportError):
            importlib.import_module("xdrlib_of_nobody")
    assert "xdrlib_of_nobody" not in sys.modules


def test_collecting_goes_on_after_a_start_that_failed():
    assert gc.isenabled()
    before = gc.get_freeze_count()
    start = quick_start.uncollected()
    start.__enter__()
    assert not gc.isenabled()
    assert not start.__exit__(ConfigError, ConfigError("x", []), None)
    assert gc.isenabled()
    assert gc.get_freeze_count() == before


def test_what_a_start_has_made_is_not_searched_at_once():
    gc.unfreeze()
    with quick_start.unsearched():
        made = [[]]
    assert any(one is made for one in gc.get_objects(generation=2))
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0


def test_a_missing_key_is_one_clear_line(tmp_path):
    config = tmp_path / "train.toml"
    config.write_text("[authentication]\n")
    done = gateway("run", "-i", "virtual", "-c", "x", "--quiet", "--config", config)
    assert done.returncode == 2
    assert done.stderr.startswith("traction-gateway: ")
    assert "auth.key" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "trip").exists(), "no start is counted that did not happen"


def test_a_candump_log_is_replayed_without_mf4_and_threads_of_numpy(tmp_path):
    (tmp_path / "x.log").write_text("(1.000000) can0 123#00\n")
    text = f"{COMMAND}\nimport os; assert len(os.listdir('/proc/self/task')) == 1"
    words = "replay", "x.log", "-o", "y.log"
    assert not loaded(("asammdf", "pandas", "pyarrow"), text, *words, folder=tmp_path)


RICH = ("FORCE_COLOR", "TTY_COMPATIBLE", "COLUMNS")
"""Variables by which rich decides, terminal or not."""
UNUSED = ("scipy", "matplotlib", "cantools", "canopen", "rich", "asyncio", "sklearn", "pywt",
          "cryptography", "asammdf", "pandas", "pyarrow", "mcap", "starlette",
          "textual")  # fmt: skip


def brief(folder, names, *words):
    """What of these a command has loaded."""
    return loaded(names, COMMAND, *words, folder=folder, **dict.fromkeys(RICH))


def test_check_loads_what_it_needs(tmp_path):
    """The simulator, NumPy and pydantic; python-can for who names a bus."""
    assert not brief(tmp_path, (*UNUSED, "can"), "check", EXAMPLE)
    assert brief(tmp_path, ("scipy", "can"), "check", EXAMPLE, "-i", "virtual", "-c", "x") == [
        "can"
    ]


def test_replay_loads_what_it_needs(tmp_path):
    words = ("replay", GOLDEN, "--config", EXAMPLE, "-o", "y.log")
    assert not brief(tmp_path, (*UNUSED, *REPORTS, "can", "sim"), *words)


def test_help_loads_no_numpy(tmp_path):
    """Nor what would load it; where it has options of a bus, these are python-can's."""
    text = """
import sys
from gateway.cli import VERBS, main
loaded = {}
for verb in VERBS:
    try:
        main([verb, "--help"])
    except SystemExit as ended:
        heavy = [m for m in ("numpy", "scipy", "matplotlib") if m in sys.modules]
        loaded[verb] = ended.code or heavy
print({verb: found for verb, found in loaded.items() if found}, len(loaded) == len(VERBS))
"""
    assert printed(text, folder=tmp_path)[-1] == "{} True"


def test_options_of_a_bus_are_part_of_the_help_and_of_what_is_refused(capsys):
    for words in (["check", "--help"], ["check"], ["check", "x.toml", "--bitrate", "much"]):
        with pytest.raises(SystemExit):
            main(words)
        out, err = capsys.readouterr()
        assert "--data-bitrate" in out + err, words


def test_a_line_that_is_piped_is_as_rich_would_print_it(capsys, monkeypatch):
    for name in RICH:
        monkeypatch.delenv(name, raising=False)
    words = "replayed 21.00 s of can0 in 0.18 s (120 times real time), 2101 ticks"
    for text in (words, 3 * words, "[red]x[/red]", "a:smile: b: c", "12:30 \u2603", "tab\tx", ""):
        for wrap in (False, True):
            note(text, wrap=wrap)
            ours = capsys.readouterr().err
            console().print(text, markup=False, soft_wrap=not wrap)
            assert ours == capsys.readouterr().err, (text, wrap)


@pytest.mark.parametrize("verb", ["check", "replay"])
def test_what_ends_at_once_has_printed_all_and_done_what_was_registered(verb, tmp_path):
    (tmp_path / "x.log").write_text("(1.000000) can0 123#00\n")
    text = """
import atexit, sys
from gateway.cli import program
atexit.register(lambda: open("ended", "w").write("yes"))
atexit.register(print, "the end")
program()
"""
    file = str(EXAMPLE) if verb == "check" else "x.log"
    lines = printed(text, verb, file, folder=tmp_path)
    assert lines[-1] == "the end"
    assert len(lines) > 3
    assert (tmp_path / "ended").read_text() == "yes"
    done = ended("-c", text, verb, "missing", folder=tmp_path)
    assert done.returncode == 2
    assert "missing: no such file" in done.stderr


def test_what_only_papers_need_is_asked_for_by_its_extra(tmp_path):
    text = """
import importlib.util
known = importlib.util.find_spec
import gateway.io.extras as extras
extras.find_spec = lambda name: None if name in ("autograd", "pywt", "sklearn") else known(name)
from gateway.cli import main
print(main(["reproduce", "thermal", "-o", "out"]))
"""
    done = ended("-c", text, folder=tmp_path)
    assert done.stdout == "2\n"
    assert (
        "needs autograd, pywt, sklearn: pip install 'autograd>=1.8' 'PyWavelets>=1.7' "
        in done.stderr
    )
    assert not (tmp_path / "out").exists()

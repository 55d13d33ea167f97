"""Signed configurations: nothing but what was signed is taken, and the reason is one line."""

import random
import re
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from dbc.codec import bind
from gateway.cli import main
from gateway.core.gateway import Gateway
from gateway.hil.fitting import scenario_thermal
from gateway.io.prepare import prepare
from gateway.io.signing import NONE, ROLES, digests, make_keys, sign, verified
from gateway.settings import calibration
from gateway.settings.config import ConfigError, load, shipped_dbc

CALIBRATION = Path(scenario_thermal()["calibration"])
MUTATIONS = 500
TOML = '[dbc]\nfile = "train.dbc"\n[thermal]\ncalibration = "motors.toml"\n'


class Signed:
    """A signed configuration with a DBC and a calibration of its own, and its keys elsewhere."""

    def __init__(self, folder):
        self.folder = folder / "config"
        self.folder.mkdir()
        self.config = self.folder / "train.toml"
        self.config.write_text(TOML)
        # Not the shipped bytes: cantools reads it.
        dbc = shipped_dbc("traction.dbc").read_bytes() + b"\n"
        (self.folder / "train.dbc").write_bytes(dbc)
        shutil.copy(CALIBRATION, self.folder / "motors.toml")
        self.private, self.public = folder / "key.pem", folder / "key.pub.pem"
        make_keys(self.private, self.public)
        self.signature = self.folder / "train.toml.sig"
        self.main("sign", "--key", self.private)

    def main(self, verb, *words):
        assert main([verb, str(self.config), *map(str, words)]) == 0

    def refused(self, capsys, *words):
        """The line with which `verify` refuses."""
        capsys.readouterr()
        public = () if "--public-key" in words else ("--public-key", self.public)
        assert main(["verify", str(self.config), *map(str, (*public, *words))]) == 2
        said = capsys.readouterr().err
        assert said.startswith("traction-gateway: ")
        assert said.count("\n") == 1
        assert "Traceback" not in said
        return said


@pytest.fixture
def signed(tmp_path):
    return Signed(tmp_path)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """For tests that put back what they change."""
    return Signed(tmp_path_factory.mktemp("signed"))


def said_hash(text):
    found = re.search(r"hash ([0-9a-f]{6})", text)
    assert found is not None, text
    return found[1]


def test_what_was_signed_is_taken_and_named_as_on_the_bus(kept, capsys):
    kept.main("verify", "--public-key", kept.public)
    word = said_hash(capsys.readouterr().out)
    kept.main("check", "--public-key", kept.public, "--no-timing")
    out = capsys.readouterr().out
    assert said_hash(out) == word
    assert f"by the owner of {kept.public}" in out
    config = load(kept.config)
    gateway = Gateway(config, bind(config.dbc_path, config.nodes), 0)
    assert f"{gateway.outbox.config_hash:06x}" == word


@pytest.mark.parametrize("name", ["train.toml", "train.dbc", "motors.toml", "train.toml.sig"])
def test_any_changed_byte_is_refused(kept, name):
    """500 mutations in four files; a quarter of them insert or delete."""
    path, rng = kept.folder / name, random.Random(name)
    before = path.read_bytes()
    options = type("Options", (), {"public_key": kept.public, "signature": None})()
    refused = 0
    try:
        for k in range(MUTATIONS // 4):
            at = rng.randrange(len(before))
            kind = k % 8
            new = rng.choice([b for b in range(256) if b != before[at]])
            if kind == 0:
                path.write_bytes(before[:at] + bytes((new,)) + before[at:])
            elif kind == 1:
                path.write_bytes(before[:at] + before[at + 1 :])
            else:
                path.write_bytes(before[:at] + bytes((new,)) + before[at + 1 :])
            with pytest.raises(ConfigError, match=r"sign"):
                prepare(kept.config, signature=options)
            refused += 1
    finally:
        path.write_bytes(before)
    assert refused == MUTATIONS // 4
    calibration.of(prepare(kept.config, signature=options)[0])


def test_the_reason_names_the_file(signed, capsys):
    for name in ("train.toml", "train.dbc", "motors.toml"):
        path = signed.folder / name
        before = path.read_bytes()
        path.write_bytes(before + b"\n")
        said = signed.refused(capsys)
        assert str(path) in said
        assert "is not the file that was signed" in said
        path.write_bytes(before)


def test_without_a_signature_or_with_anothers_nothing_runs(signed, tmp_path, capsys):
    other = tmp_path / "other.pem", tmp_path / "other.pub.pem"
    make_keys(*other)
    assert "was not made with the key of" in signed.refused(capsys, "--public-key", other[1])
    assert "no public key" in signed.refused(capsys, "--public-key", tmp_path / "none.pem")
    assert "no public ed25519 key" in signed.refused(capsys, "--public-key", signed.private)
    elsewhere = tmp_path / "elsewhere.sig"
    assert "no signature" in signed.refused(capsys, "--signature", elsewhere)
    shutil.move(signed.signature, elsewhere)
    assert "no signature" in signed.refused(capsys)
    signed.main("verify", "--public-key", signed.public, "--signature", elsewhere)


@pytest.mark.parametrize(
    "verb", [("run", "-i", "virtual", "-c", "x"), ("replay", "none.log"), ("hil", "wet_one")]
)
def test_every_way_to_run_refuses(signed, verb, refused):
    signed.config.write_text(TOML + "[bus]\nfd = true\n")
    words = [*verb, "--config", str(signed.config), "--public-key", str(signed.public)]
    assert "is not the file that was signed" in refused(*words)
    assert "built-in configuration has no signature" in refused(
        *verb, "--public-key", signed.public
    )
    assert "without --public-key" in refused(
        *verb, "--config", signed.config, "--signature", "x.sig"
    )


def test_a_dbc_put_beside_the_configuration_is_not_the_shipped_one(signed, capsys):
    """A name that ships with the program may be overlaid by a file beside: that is signed, too."""
    signed.config.write_text("")
    signed.main("sign", "--key", signed.private)
    signed.main("verify", "--public-key", signed.public)
    shutil.copy(shipped_dbc("traction_fd.dbc"), signed.folder / "traction.dbc")
    assert "is not the file that was signed" in signed.refused(capsys)


def test_files_of_two_signatures_cannot_be_mixed(signed, capsys):
    first = signed.signature.read_text().splitlines(keepends=True)
    signed.config.write_text(TOML + "[loop]\nrate_hz = 200\n")
    signed.main("sign", "--key", signed.private)
    second = signed.signature.read_text().splitlines(keepends=True)
    signed.signature.write_text("".join([first[0], second[1], *first[2:]]))
    assert "was not made with the key of" in signed.refused(capsys)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text + "\n",
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.upper(),
        lambda text: text.replace("dbc", "dbc "),
        lambda text: text.replace("signature ", "signature  "),
        lambda text: text.replace("config ", "config x", 1),
        lambda text: "",
        lambda text: "signature ",
        lambda text: text.split("signature")[0],
        lambda text: text.replace("calibration", "kalibration"),
    ],
)
def test_a_signature_file_is_exactly_what_was_written(signed, change, capsys):
    text = signed.signature.read_text()
    signed.signature.write_bytes(change(text).encode())
    signed.refused(capsys)


def test_no_calibration_is_signed_as_none(signed):
    signed.config.write_text('[dbc]\nfile = "train.dbc"\n')
    seals = digests(signed.config, load(signed.config))
    assert tuple(seals) == ROLES
    assert seals["calibration"] == NONE
    text, _ = sign(signed.config, load(signed.config), signed.private)
    signed.signature.write_text(text)
    assert verified(signed.signature, signed.public) == seals


def test_openssl_agrees_with_keys_and_signature(signed, tmp_path):
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    said, _, last = signed.signature.read_bytes().rpartition(b"signature ")
    (tmp_path / "said").write_bytes(said)
    raw = subprocess.run(["openssl", "base64", "-d", "-A"], input=last, capture_output=True,
                         check=True).stdout  # fmt: skip
    (tmp_path / "raw").write_bytes(raw)
    done = subprocess.run(
        ["openssl", "pkeyutl", "-verify", "-pubin", "-inkey", str(signed.public), "-rawin",
         "-in", str(tmp_path / "said"), "-sigfile", str(tmp_path / "raw")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "Successfully" in done.stdout


def test_private_keys_are_private_and_of_the_right_kind(signed, tmp_path, refused):
    assert signed.private.stat().st_mode & 0o777 == 0o600
    signed.private.chmod(0o644)
    assert "chmod 600" in refused("sign", signed.config, "--key", signed.private)
    wrong = tmp_path / "wrong.pem"
    wrong.write_text("no key")
    wrong.chmod(0o600)
    assert "no private ed25519 key" in refused("sign", signed.config, "--key", wrong)
    assert "File exists" in refused("keygen", "-o", signed.private)


def test_what_cannot_be_used_is_not_signed(signed, refused):
    signed.config.write_text("[loop]\nrate = 5\n")
    assert "loop.rate" in refused("sign", signed.config, "--key", signed.private)


def test_the_hash_covers_configuration_dbc_and_calibration(signed):
    """24 bits name a configuration, they do not prove it; the signature does."""

    def word():
        config = load(signed.config)
        codec = bind(config.dbc_path, config.nodes)
        return calibration.config_hash(config, codec.digest, calibration.of(config))

    seen = {word()}
    dbc = signed.folder / "train.dbc"
    dbc.write_bytes(dbc.read_bytes() + b"\n")
    seen.add(word())
    signed.config.write_text(TOML + "[loop]\nrate_hz = 200\n")
    seen.add(word())
    cells = calibration.load(signed.folder / "motors.toml", (1, 2, 3), 5.0)
    other = cells.model_copy(update={"maisd_limit_k": (9.0, 9.0, 9.0)})
    (signed.folder / "motors.toml").write_text(calibration.to_toml(other))
    seen.add(word())
    assert len(seen) == 4


def test_reports_name_the_configuration(signed, tmp_path, capsys):
    signed.main("verify", "--public-key", signed.public)
    word = said_hash(capsys.readouterr().out)
    log = tmp_path / "drive.log"
    assert main(["sim", "wet_one", "--duration", "0.5", "-o", str(log)]) == 0
    capsys.readouterr()
    assert main(["replay", str(log), "--config", str(signed.config),
                 "--results", str(tmp_path / "results")]) == 0  # fmt: skip
    assert f"configuration: {word}" in capsys.readouterr().out
    assert (tmp_path / "results" / "configuration.txt").read_text().split()[-1] == word
    assert main(["hil", "wet_one", "--config", str(signed.config),
                 "--junit", str(tmp_path / "j.xml")]) in (0, 1)  # fmt: skip
    named = ET.parse(tmp_path / "j.xml").find(".//property[@name='config_hash']")
    assert named is not None
    assert named.attrib["value"] == word, "what was tested is what was signed"

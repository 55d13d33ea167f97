"""Keys and start numbers: whose files are taken, and what is said of the others."""

import logging
import os
import threading
from pathlib import Path

import pytest

from gateway.cli import main
from gateway.io.credentials import flag_authenticator, flag_key, next_trip, trip_path
from gateway.settings.config import ConfigError, parse

SECRET = "00112233445566778899aabbccddeeff"
KEY = SECRET.encode()


@pytest.fixture(autouse=True)
def no_service(monkeypatch):
    for name in ("CREDENTIALS_DIRECTORY", "STATE_DIRECTORY"):
        monkeypatch.delenv(name, raising=False)


def key_file(folder, content=KEY, mode=0o600):
    path = folder / "auth.key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


@pytest.mark.parametrize("content", [SECRET, SECRET.upper() + "\n", f" {SECRET}\r\n"])
@pytest.mark.parametrize("mode", [0o600, 0o400])
def test_a_key_is_32_hexadecimal_digits_for_its_owner_only(tmp_path, content, mode):
    key_file(tmp_path, content.encode(), mode)
    assert flag_key("auth.key", tmp_path) == bytes.fromhex(SECRET)


def test_a_key_may_be_16_bytes(tmp_path):
    key_file(tmp_path, bytes(range(16)))
    assert flag_key("auth.key", tmp_path) == bytes(range(16))


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o644, 0o610, 0o601])
def test_a_key_that_others_reach_is_refused_with_the_cure(tmp_path, mode):
    path = key_file(tmp_path, mode=mode)
    with pytest.raises(ConfigError, match=f"chmod 600 {path}") as caught:
        flag_key("auth.key", tmp_path)
    assert SECRET not in str(caught.value)


@pytest.mark.parametrize(
    "content", [b"", b"12", SECRET[:-1].encode(), SECRET.encode() * 2, b"\xff" * 17, b"00" * 16]
)
def test_what_is_no_key_is_refused_and_not_repeated(tmp_path, content):
    key_file(tmp_path, content)
    with pytest.raises(ConfigError, match="is not a key") as caught:
        flag_key("auth.key", tmp_path)
    assert SECRET[:8] not in str(caught.value)


def test_neither_a_folder_nor_a_pipe_nor_nothing_is_a_key(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        flag_key("none.key", tmp_path)
    os.mkfifo(tmp_path / "pipe", 0o600)
    with pytest.raises(ConfigError, match="not a regular file"):
        flag_key("pipe", tmp_path)
    (tmp_path / "folder").mkdir(mode=0o700)
    with pytest.raises(ConfigError, match=r"not a regular file|cannot be read"):
        flag_key("folder", tmp_path)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_a_key_of_somebody_else_is_refused(tmp_path):
    os.chown(key_file(tmp_path), 12345, -1)
    with pytest.raises(ConfigError, match="belongs to user 12345"):
        flag_key("auth.key", tmp_path)


def test_a_credential_of_the_service_comes_first(tmp_path, monkeypatch):
    given = tmp_path / "credentials"
    given.mkdir()
    key_file(given, mode=0o440)  # as an access list shows
    key_file(tmp_path, bytes(range(16)))
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(given))
    assert flag_key("auth.key", tmp_path) == bytes.fromhex(SECRET)
    assert flag_key(str(tmp_path / "auth.key"), Path()) == bytes(range(16))
    (given / "auth.key").unlink()
    assert flag_key("auth.key", tmp_path) == bytes(range(16))


def test_starts_are_counted_on_disk(tmp_path):
    trip = tmp_path / "trip"
    assert [next_trip(trip) for _ in range(3)] == [1, 2, 3]
    assert trip.read_text() == "00000003\n"
    assert trip.stat().st_mode & 0o777 == 0o600
    trip.write_text("41")
    assert next_trip(trip) == 42


@pytest.mark.parametrize("content", ["", "x", "-3", "1.5", "123456789", "1\x00", "٣"])
def test_a_damaged_count_does_not_begin_again(tmp_path, content):
    """Numbers that come twice are keys to the past."""
    trip = tmp_path / "trip"
    trip.write_text(content)
    with pytest.raises(ConfigError, match="higher than that of any start"):
        next_trip(trip)
    assert trip.read_text() == content


def test_the_last_number_and_a_place_that_cannot_be_written_are_refused(tmp_path):
    trip = tmp_path / "trip"
    trip.write_text(str((1 << 24) - 1))
    with pytest.raises(ConfigError, match="used up"):
        next_trip(trip)
    with pytest.raises(ConfigError, match="cannot be counted"):
        next_trip(tmp_path / "none" / "trip")
    (tmp_path / "link").symlink_to(trip)
    with pytest.raises(ConfigError, match="cannot be counted"):
        next_trip(tmp_path / "link")


def test_two_that_start_together_get_two_numbers(tmp_path):
    (tmp_path / "trip").write_text("7")
    got = []
    starters = [
        threading.Thread(target=lambda: got.append(next_trip(tmp_path / "trip"))) for _ in range(20)
    ]
    for starter in starters:
        starter.start()
    for starter in starters:
        starter.join()
    assert sorted(got) == list(range(8, 28))


def test_the_service_counts_in_its_state_directory(tmp_path, monkeypatch):
    chosen = parse({"authentication": {}}).authentication
    assert chosen is not None
    assert trip_path(chosen, Path("/etc/x")) == Path("/etc/x/trip")
    monkeypatch.setenv("STATE_DIRECTORY", f"{tmp_path}:/else")
    assert trip_path(chosen, Path("/etc/x")) == tmp_path / "trip"


def test_the_sender_begins_with_its_own_start_and_nothing_is_logged(tmp_path, caplog, capfd):
    caplog.set_level(logging.DEBUG)
    key_file(tmp_path)
    config = parse({"authentication": {}}, base=tmp_path)
    for start in (1, 2):
        sender = flag_authenticator(config)
        assert sender is not None
        assert sender.freshness == start << 40
    assert flag_authenticator(parse({})) is None
    said = capfd.readouterr()
    assert SECRET not in caplog.text + said.out + said.err + repr(sender) + config.model_dump_json()


def test_keygen_makes_a_key_that_is_taken_and_overwrites_nothing(tmp_path, capsys, refused):
    path = tmp_path / "auth.key"
    words = ["keygen", "--flags", "-o", str(path)]
    assert main(words) == 0
    assert path.stat().st_mode & 0o777 == 0o600
    key = flag_key("auth.key", tmp_path)
    assert key.hex() not in capsys.readouterr().out
    assert "File exists" in refused(*words)
    assert flag_key("auth.key", tmp_path) == key

"""BLF: what is damaged costs what is lost, which is counted, and makes no frame of its own."""

import re
import struct
import zlib

import pytest

from dbc.candump.grammar import Verdict
from dbc.candump.reader import LogError
from dbc.frame import ERROR, FD, TX, Frame
from dbc.logs.blf import Blf
from gateway.cli import main

START = (2025, 9, 1, 29, 13, 0, 0, 0)
START_NS = 1_759_150_800_000_000_000
COUNT, SIZE = 2000, 1000
FDF = 0x1000
"""Of the flags of a CANFD_MESSAGE_64."""


def an_object(kind, t_ns, body):
    """One with a header of version 1, in nanoseconds."""
    head = struct.pack("<4sHHLL", b"LOBJ", 32, 1, 32 + len(body), kind)
    data = head + struct.pack("<LHHQ", 2, 0, 0, t_ns) + body
    return data + bytes(len(data) % 4)


def classic(t_ns, can_id, data, flags=0, kind=1):
    """A CAN_MESSAGE, or CAN_MESSAGE2."""
    more = bytes(8) if kind == 86 else b""
    return an_object(kind, t_ns, struct.pack("<HBBL8s", 1, flags, len(data), can_id, data) + more)


def fd_100(dlc, data, *, fd = 1, valid = None, flags = 0,
           room = 64):  # fmt: skip
    """A CANFD_MESSAGE."""
    valid = len(data) if valid is None else valid
    head = struct.pack("<HBBLLBBB5x", 1, flags, dlc, 0x181, 0, 0, fd, valid)
    return an_object(100, 0, head + data.ljust(room, b"\0"))


def fd_101(dlc, data, *, fd = FDF, valid = None,
           direction = 0):  # fmt: skip
    """A CANFD_MESSAGE_64."""
    valid = len(data) if valid is None else valid
    head = struct.pack(
        "<BBBBLLLLLLLHBBL", 1, dlc, valid, 0, 0x181, 0, fd, 0, 0, 0, 0, 0, direction, 0, 0
    )
    return an_object(101, 0, head + data)


def container(data, declared=None, method=2):
    """Of these objects."""
    packed = zlib.compress(data) if method == 2 else data
    return outside(packed, len(data) if declared is None else declared, method)


def outside(packed, declared, method=2):
    """A container with these bytes, whatever they are."""
    body = struct.pack("<H6xL4x", method, declared) + packed
    return struct.pack("<4sHHLL", b"LOBJ", 16, 1, 16 + len(body), 10) + body + bytes(len(body) % 4)


def blf(path, parts, count=0):
    """A file; count: of its objects, in its header."""
    size = 144 + sum(map(len, parts))
    head = struct.pack(
        "<4sLBBBBBBBBQQLL8H8H", b"LOGG", 144, 5, *[0] * 7, size, 0, count, 0, *START, *START
    )
    path.write_bytes(head.ljust(144, b"\0") + b"".join(parts))
    return path


OBJECTS = [classic(k * 1_000_000, 0x100 + k % 16, struct.pack("<Q", k)) for k in range(COUNT)]


def pieces(data):
    """As containers have them: their ends are not those of objects."""
    return [data[k : k + SIZE] for k in range(0, len(data), SIZE)]


PARTS = pieces(b"".join(OBJECTS))
CONTAINERS = [container(part) for part in PARTS]


def flipped(data):
    """A container whose compressed bytes are damaged."""
    whole = bytearray(container(data))
    for k in range(40, 60):
        whole[k] ^= 0xFF
    return bytes(whole)


def cut_short(data):
    """One whose compressed bytes end early; zlib finds nothing wrong with those that are there."""
    packed = zlib.compress(data)
    return outside(packed[: len(packed) // 2], len(data))


def no_signature(data):
    """One that does not look like an object."""
    return b"XXXX" + container(data)[4:]


def stored_short(data):
    """Not compressed, and half of it missing."""
    return outside(data[: SIZE // 2], SIZE, 0)


def with_wrong_size(data):
    """An object in it says that it is larger than it is."""
    return container(data.replace(b"\x30\0\0\0\1\0\0\0", b"\x50\0\0\0\1\0\0\0", 1))


def with_huge_size(data):
    """An object in it, of a kind that is not known, says that it has megabytes."""
    return container(data.replace(b"\x30\0\0\0\1\0\0\0", b"\0\0\0\2\xc8\0\0\0", 1))


def with_large_size(data):
    """One that says that the next containers are a part of it."""
    whole = bytearray(container(data))
    struct.pack_into("<L", whole, 8, len(whole) + 3000)
    return bytes(whole)


@pytest.mark.parametrize("count", [COUNT, 0, 50_000_000])
@pytest.mark.parametrize(
    ("damage", "most"),
    [(flipped, 23), (cut_short, 23), (no_signature, 23), (stored_short, 14),
     (with_wrong_size, 1), (with_huge_size, 1),
     (with_large_size, 23)],
)  # fmt: skip
@pytest.mark.parametrize("last", [False, True])
def test_a_damaged_container_costs_its_objects_and_makes_none(tmp_path, damage, most, count, last):
    whole = CONTAINERS.copy()
    k = len(PARTS) - 1 if last else len(PARTS) // 2
    whole[k] = damage(PARTS[k])
    reader = Blf(blf(tmp_path / "a.blf", whole, count))
    frames = list(reader)
    good = {
        Frame(START_NS + k * 1_000_000, 0x100 + k % 16, struct.pack("<Q", k), 0, "0")
        for k in range(COUNT)
    }
    assert len(frames) == len(set(frames))
    assert set(frames) <= good
    lost = COUNT - len(frames)
    assert lost <= most
    lost = max(lost, 1)  # the last container can be whole, but for its size
    counted = reader.counts[Verdict.MALFORMED] + reader.counts[Verdict.CUT]
    assert counted == lost if count == COUNT else abs(counted - lost) <= max(2, lost // 2)
    with pytest.raises(LogError):
        list(Blf(reader.path, strict=True).blocks())


def test_a_container_that_is_missing_is_counted(tmp_path):
    reader = Blf(blf(tmp_path / "a.blf", CONTAINERS[:40] + CONTAINERS[41:], COUNT))
    assert len(list(reader)) + reader.counts[Verdict.MALFORMED] == COUNT


def test_more_than_one_percent_lost_is_exit_1(tmp_path, capsys):
    whole = CONTAINERS.copy()
    for k in (20, 40):
        whole[k] = flipped(PARTS[k])
    path = blf(tmp_path / "a.blf", whole, COUNT)
    assert main(["convert", str(path), str(tmp_path / "a.log")]) == 1
    shown = capsys.readouterr()
    read, lost = re.search(r"malformed (\d+), ok (\d+)", shown.out).groups()
    assert int(read) + int(lost) == COUNT
    assert "of the input was dropped" in shown.err


def test_data_that_look_like_an_object_make_no_frame(tmp_path):
    """The first object after a hole is searched for; data of a frame may look like one."""
    odd = [classic(k * 1_000_000, 0x100, b"LOBJ" + struct.pack("<HH", 32, 1)) for k in range(60)]
    data = b"".join(odd)
    whole = [container(data[:1000]), flipped(data[1000:2020]), container(data[2020:])]
    frames = list(Blf(blf(tmp_path / "a.blf", whole, 60)))
    assert {(f.can_id, f.data) for f in frames} == {(0x100, b"LOBJ\x20\0\1\0")}
    assert [(f.t_ns - START_NS) // 1_000_000 for f in frames] == [*range(20), *range(43, 60)]


def test_a_cut_file_counts_what_its_header_promises(tmp_path):
    path = blf(tmp_path / "a.blf", CONTAINERS, COUNT)
    path.write_bytes(path.read_bytes()[: -sum(map(len, CONTAINERS[50:])) - 10])
    reader = Blf(path)
    frames = list(reader)
    assert len(frames) + reader.counts[Verdict.CUT] == COUNT
    assert f"{COUNT - len(frames)} of {COUNT} objects are missing" in reader.truncated


@pytest.mark.parametrize(
    ("count", "noted"),
    [(90, False), (0, False), (50, False), (87, False), (88, False), (91, False), (100, True)],
)
def test_fewer_objects_than_the_header_says_is_a_note(tmp_path, count, noted):
    """Vector leaves restore points out of its count, others may count containers."""
    objects = OBJECTS[:87] + [an_object(115, 0, bytes(24)) for _ in range(3)]
    reader = Blf(blf(tmp_path / "a.blf", [container(b"".join(objects))], count))
    assert len(list(reader)) == 87
    assert not any(verdict.is_fault for verdict in reader.counts)
    assert reader.notes == ["the file's header says 100 objects; it has 90"] * noted


@pytest.mark.parametrize("declared", [0, 500, 4])
def test_a_container_with_the_right_checksum_is_whole(tmp_path, declared):
    """CANoe ends a file with an empty container; some writers leave its size out."""
    parts = [container(part, declared) for part in pieces(b"".join(OBJECTS[:100]))]
    reader = Blf(blf(tmp_path / "a.blf", [*parts, container(b"", 0)]))
    assert len(list(reader)) == 100
    assert dict(reader.counts) == {Verdict.OK: 100}


@pytest.mark.parametrize("padding", [0, 1, 2, 3])
def test_containers_may_be_padded_in_any_way(tmp_path, padding):
    parts = []
    for part in pieces(b"".join(OBJECTS[:200])):
        whole = container(part)
        size = struct.unpack_from("<L", whole, 8)[0]
        parts.append(whole[:size] + bytes(padding))
    reader = Blf(blf(tmp_path / "a.blf", parts))
    assert len(list(reader)) == 200
    assert dict(reader.counts) == {Verdict.OK: 200}


# ---- objects ----------------------------------------------------------------------------------


def read_one(tmp_path, *objects):
    """Frames of these objects, and counts."""
    reader = Blf(blf(tmp_path / "a.blf", [container(b"".join(objects))]))
    return list(reader), dict(reader.counts)


@pytest.mark.parametrize("kind", [1, 86])
@pytest.mark.parametrize("many", [1, 40])
def test_a_request_to_send_is_no_frame(tmp_path, kind, many):
    """One by one, and in runs."""
    pair = [classic(0, 0x181, b"\1", 2, kind), classic(1, 0x181, b"\1", 1, kind)]
    frames, counts = read_one(tmp_path, *pair * many)
    assert counts == {Verdict.OK: many, Verdict.REQUEST: many}
    assert {f.flags for f in frames} == {TX}
    frames, counts = read_one(tmp_path, *[pair[0]] * many)
    assert (frames, counts) == ([], {Verdict.REQUEST: many})


@pytest.mark.parametrize(
    "make",
    [lambda way: fd_100(8, bytes(8), flags=way), lambda way: fd_101(8, bytes(8), direction=way)],
)
def test_a_request_to_send_of_can_fd(tmp_path, make):
    frames, counts = read_one(tmp_path, make(0), make(2), make(1))
    assert [f.flags for f in frames] == [FD, FD | TX]
    assert counts == {Verdict.FD: 2, Verdict.REQUEST: 1}


@pytest.mark.parametrize(
    "make",
    [lambda n: fd_100(n, b"\1" * 8, fd=0), lambda n: fd_101(n, b"\1" * 8, fd=0),
     lambda n: an_object(1, 0, struct.pack("<HBBL8s", 1, 0, n, 0x181, b"\1" * 8))],
)  # fmt: skip
@pytest.mark.parametrize("dlc", [8, 9, 15])
def test_a_raw_dlc_of_a_classic_frame_is_kept(tmp_path, make, dlc):
    frames, _ = read_one(tmp_path, make(dlc))
    assert frames == [Frame(START_NS, 0x181, b"\1" * 8, 0, "0", dlc if dlc > 8 else -1)]


@pytest.mark.parametrize("make", [fd_100, fd_101])
def test_the_dlc_says_how_long_a_frame_is(tmp_path, make):
    """What is not there is zero, as python-can has it."""
    frames, _ = read_one(
        tmp_path,
        make(9, b"\1\2\3"),
        make(15, b"\1" * 64),
        make(9, b"\1" * 64),
        make(3, b"\1", fd=0),
    )
    assert [f.data for f in frames] == [
        b"\1\2\3" + bytes(9), b"\1" * 64, b"\1" * 12, b"\1\0\0",
    ]  # fmt: skip
    assert read_one(tmp_path, make(16, b"\1" * 10))[1] == {Verdict.BAD_LENGTH: 1}


@pytest.mark.parametrize(
    "one",
    [fd_100(9, b"\1" * 8, valid=12, room=8), classic(0, 0x181, b"\1" * 8)[:44],
     an_object(73, 0, bytes(8)), an_object(101, 0, bytes(20)), an_object(104, 0, b"")],
)  # fmt: skip
def test_an_object_that_is_too_short_takes_nothing_of_the_next(tmp_path, one):
    one = one[:8] + struct.pack("<L", len(one)) + one[12:]
    frames, counts = read_one(tmp_path, one, OBJECTS[0])
    assert len(frames) == 1
    assert counts == {Verdict.OK: 1, Verdict.MALFORMED: 1}


def test_error_objects(tmp_path):
    frames, _ = read_one(
        tmp_path, an_object(2, 0, b"\2\0\0\0"), an_object(104, 0, b"\3" + bytes(59))
    )
    assert [(f.flags, f.channel) for f in frames] == [(ERROR, "1"), (ERROR, "2")]


def test_what_is_no_frame_is_counted_and_times_may_lie_before_the_start(tmp_path):
    early, later = classic(-60_000_000 % 2**64, 0x181, b"\1"), classic(7, 0x182, b"")
    objects = (early, an_object(6, 0, bytes(16)), later)
    whole = b"".join(objects)
    for parts in ([container(whole)], [container(whole[:50]), container(whole[50:])], objects):
        reader = Blf(blf(tmp_path / "a.blf", list(parts)))
        assert [(f.t_ns - START_NS, f.can_id) for f in reader] == [(-60_000_000, 0x181), (7, 0x182)]
        assert dict(reader.counts) == {Verdict.OK: 2, Verdict.EVENT: 1}
        assert reader.lines == 3

"""Files that `shrink` writes into a folder: a candump log, a start record, and a pytest file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from dbc.candump.writer import NotWritableError, Writer
from dbc.codec import Codec
from dbc.frame import SECOND
from dbc.text import printable
from gateway.core.start_record import resumed, start_bytes
from gateway.io.log_file import BadLogError, open_log
from gateway.io.replay import replay
from gateway.io.whole_file import whole, write_text
from gateway.logfiles.shrink import SENT_IN, Shrunk, Wanted
from gateway.settings.config import Config

LOG, START, TEST = "shrunk.log", "start.bin", "test_shrunk.py"
_TEXT: Final = '''\
"""The {flag} is {state} {at_s:.3f} s after the first frame of {log}.

Made by `traction-gateway shrink`: {kept} of {total} frames, from {start_s:.3f} s on.
"""

from pathlib import Path

import gateway

HERE = Path(__file__).parent
CONFIG = {config}


def test_{name}():
    run = gateway.replay(HERE / "{LOG}", CONFIG, start=HERE / "{START}")
    sent = [frame.data.hex() for frame in run.frames if frame[:2] == ({t_ns}, {can_id:#x})]
    assert sent == ["{data}"]  # {message}
'''


def write_test(
    folder: Path, shrunk: Shrunk, wanted: Wanted, config_file: Path | None, log: Path
) -> None:
    """Write the three files. config_file: the configuration, None for the built-in one.

    Raises BadLogError if a frame cannot be written as candump text.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with whole(folder / LOG) as part, Writer(part) as writer:
        try:
            writer.write_block(shrunk.frames)
        except NotWritableError as error:
            raise BadLogError(f"a frame that the flag needs {error}") from error
    with whole(folder / START) as part:
        part.write_bytes(start_bytes(shrunk.gateway, shrunk.start))
    sent = shrunk.flag_frame
    config = "None"
    if config_file is not None:
        config = f"HERE / {os.path.relpath(config_file.resolve(), folder.resolve())!r}"
    write_text(folder / TEST, _TEXT.format(
        LOG=LOG, START=START, flag=wanted.name, state=shrunk.word, config=config,
        at_s=(shrunk.change.now_ns - shrunk.first_ns) / SECOND, log=printable(log.name),
        start_s=(shrunk.start.now_ns - shrunk.first_ns) / SECOND, kept=f"{shrunk.frames.size:,}",
        total=f"{shrunk.total:,}", name=f"{wanted.kind.name.lower()}_of_drive_{wanted.node}",
        t_ns=sent.t_ns, can_id=sent.can_id, data=sent.data.hex(), message=SENT_IN[wanted.kind],
    ))  # fmt: skip


def read_back(folder: Path, shrunk: Shrunk, config: Config, codec: Codec) -> None:
    """Raises BadLogError if a replay of the written files does not send the same flag frame."""
    start = folder / START
    gateway = resumed(start.read_bytes(), str(start), config, codec)
    sent = []
    replay(open_log(folder / LOG, strict=True).blocks, lambda _first: gateway,
           config.loop.period_ns, lambda _now, out, _gateway: sent.extend(out))  # fmt: skip
    if shrunk.flag_frame not in sent:
        raise BadLogError(f"{folder / LOG}: as a candump log it does not give the same flag")

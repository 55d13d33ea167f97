"""MCAP by the `mcap` library: JSON messages with a JSON schema, for Foxglove and PlotJuggler.

Topic `/can/frames` has every frame; `/CHANNEL/MESSAGE` has the decoded signals of one message on
one bus.
"""

from __future__ import annotations

import json
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from operator import itemgetter
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from dbc.frame import Nanos
from dbc.frames import Block
from dbc.spec import MessageSpec
from dbc.text import printable
from gateway.logfiles.channels import UNNAMED
from gateway.logfiles.frames import FLAGS, Sink, interface, without
from gateway.logfiles.signal_files import MARKS, Comments, decimal, labels_of
from gateway.logfiles.signals import Decoder, is_exact

LABELS: Final = "labels"
"""Field with the names of named values, beside the signals; a signal of this name replaces it."""
_FRAME: Final = {
    **{name: {"type": "string"} for name in ("channel", "id_hex", "data")},
    **{name: {"type": "integer"} for name in ("id", "dlc")},
    **{name: {"type": "boolean"} for name in FLAGS},
}
Message = tuple[Nanos, int, str]
"""Time, number of the MCAP channel, JSON."""


class _Topic(NamedTuple):
    """Topic of a message: MCAP channel, names of the signals, and (place, labels), all as JSON."""

    number: int
    keys: list[str]
    labels: list[tuple[int, dict[float, str]]]
    exact: list[int]
    """Places of the signals whose integers a float cannot hold."""


class McapFile(Sink, AbstractContextManager["McapFile"]):
    """Frames on `/can/frames`, and with a decoder their signals. Messages are in time order.

    `reduced` counts frames that the DBC does not decode, under the key `signals`.
    """

    def __init__(
        self, path: Path, decoder: Decoder | None = None, comments: Comments | None = None
    ) -> None:
        """Create the file. Raises OSError."""
        from mcap.writer import Writer

        super().__init__()
        self._decoder, self._comments = decoder, comments or {}
        self._file = path.open("wb")
        self._writer = Writer(self._file)
        self._writer.start(library="traction-gateway")
        self._schemas: dict[tuple[str, bytes], int] = {}
        self._channels: dict[str, int] = {}
        self._waiting: list[Message] = []
        self._frames = self.channel("/can/frames", "traction.Frame", _FRAME)
        self._topics: dict[tuple[str, int], _Topic] = {}
        self._starts: dict[tuple[str, int, int, int], str] = {}

    def channel(self, topic: str, name: str, properties: Mapping[str, Any]) -> int:
        """Number of a topic's MCAP channel. name, properties: JSON schema, for the first call."""
        if topic not in self._channels:
            schema = {"type": "object", "properties": properties}
            key = printable(name), json.dumps(schema, separators=(",", ":")).encode()
            if key not in self._schemas:
                self._schemas[key] = self._writer.register_schema(key[0], "jsonschema", key[1])
            number = self._writer.register_channel(printable(topic), "json", self._schemas[key])
            self._channels[topic] = number
        return self._channels[topic]

    def add(self, block: Block) -> None:
        """Append frames. Raises OSError."""
        self.add_frames(block)
        self.flush()

    def add_frames(self, block: Block) -> None:
        """Add frames, which wait for `flush`."""
        block = without(block, block.t_ns < 0, self.left_out, "before_1970")
        names = [interface(name) or UNNAMED for name in block.names]
        self.put(self._of_frames(block, names))
        if self._decoder is not None:
            self.put(self._of_signals(block, names, self._decoder))
        self.written += block.size

    def put(self, messages: Iterable[Message]) -> None:
        """Add messages, which wait for `flush`."""
        self._waiting += messages

    def flush(self, until_ns: Nanos | None = None) -> None:
        """Write the waiting messages up to a time; None: all. Raises OSError."""
        self._waiting.sort(key=itemgetter(0))
        if early := bisect_left(self._waiting, 0, key=itemgetter(0)):
            self.left_out["before_1970"] += early
            del self._waiting[:early]
        done = len(self._waiting)
        if until_ns is not None:
            done = bisect_right(self._waiting, until_ns, key=itemgetter(0))
        for t_ns, channel, text in self._waiting[:done]:
            self._writer.add_message(channel, t_ns, text.encode(), t_ns)
        del self._waiting[:done]

    def close(self) -> None:
        """Complete the file and close it. Raises OSError."""
        with self._file:
            self.flush()
            self._writer.finish()

    def __exit__(self, *error: object) -> None:
        """Complete the file, or only close it after an exception. Raises OSError."""
        self._file.close() if error[1] is not None else self.close()

    def _of_frames(self, block: Block, names: list[str]) -> Iterator[Message]:
        text, width = block.data.tobytes().hex(), 2 * block.data.shape[1]
        columns = block.t_ns, block.can_id, block.flags, block.length, block.dlc, block.channel
        for k, (t_ns, can_id, flags, length, dlc, channel) in enumerate(
            zip(*(column.tolist() for column in columns), strict=True)
        ):
            key = names[channel], can_id, flags, dlc
            start = self._starts.get(key) or self._start(*key)
            data = text[k * width : k * width + 2 * length]
            yield t_ns, self._frames, f'{start}"{data}"}}'

    def _start(self, channel: str, can_id: int, flags: int, dlc: int) -> str:
        """A frame's JSON up to its data; dlc: -1 if it follows from the length."""
        fields: dict[str, Any] = {"channel": channel, "id": can_id, "id_hex": f"{can_id:X}"}
        fields |= {name: flags & flag != 0 for name, flag in FLAGS.items()}
        if dlc >= 0:
            fields["dlc"] = dlc
        start = json.dumps(fields, separators=(",", ":"))[:-1] + ',"data":'
        self._starts[channel, can_id, flags, dlc] = start
        return start

    def _of_signals(self, block: Block, names: list[str], decoder: Decoder) -> Iterator[Message]:
        done = decoder.decode(block)
        self.reduced["signals"] += block.size - done.frames.size
        frames, messages = done.frames, decoder.codec.messages
        has_marks = np.atleast_1d(done.marked.any(axis=1)).tolist()
        channels, values = frames.channel.tolist(), done.value.tolist()
        rows = zip(frames.t_ns.tolist(), done.message.tolist(), strict=True)
        for k, (t_ns, index) in enumerate(rows):
            topic = self._topics.get((names[channels[k]], index))
            if topic is None:
                topic = self._topic(names[channels[k]], messages[index])
            cells = {key: decimal(value) for key, value in zip(topic.keys, values[k], strict=False)
                     if value == value}  # fmt: skip # noqa: PLR0124 - not NaN
            for place in topic.exact:
                whole = done.exact[index, place][k]
                if whole is not None:
                    cells[topic.keys[place]] = str(whole)
            labels = [f"{topic.keys[place]}:{words[value]}" for place, words in topic.labels
                      if (value := values[k][place]) in words]  # fmt: skip
            if labels:
                cells.setdefault(f'"{LABELS}"', "{" + ",".join(labels) + "}")
            if has_marks[k]:
                cells.setdefault(f'"{MARKS}"', json.dumps(done.marks(k, messages[index])))
            yield t_ns, topic.number, "{" + ",".join(map(":".join, cells.items())) + "}"

    def _topic(self, channel: str, message: MessageSpec) -> _Topic:
        """Add the topic for the signals of one message on one bus to the file."""
        properties: dict[str, Any] = {LABELS: {"type": "object"}, MARKS: {"type": "string"}}
        labels, exact = [], []
        for place, signal in enumerate(message.signals):
            words = signal.unit, self._comments.get(f"{message.name}.{signal.name}", "")
            text = "; ".join(filter(None, words))
            properties[signal.name] = {"type": "number", "description": text}
            if is_exact(signal):
                exact.append(place)
            if signal.labels and (signal.scale, signal.offset) == (1, 0):
                shown = {float(raw): json.dumps(word) for raw, word in labels_of(signal).items()}
                labels.append((place, shown))
        number = self.channel(f"/{channel}/{message.name}", f"traction.{message.name}", properties)
        keys = [json.dumps(signal.name) for signal in message.signals]
        topic = _Topic(number, keys, labels, exact)
        self._topics[channel, message.index] = topic
        return topic

"""Mutations by seed that know a little of the text: words, numbers and lines, not only bytes."""

import re

_WORD = re.compile(rb"[A-Za-z0-9_]+")
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
NUMBERS = (
    b"0", b"1", b"-1", b"2", b"7", b"8", b"16", b"17", b"63", b"64", b"65", b"255", b"256", b"511",
    b"512", b"2047", b"2048", b"65535", b"65536", b"2147483647", b"2147483648", b"4294967295",
    b"536870911", b"3221225472", b"9223372036854775807", b"9223372036854775808", b"1e308",
    b"-1e308", b"1e-320", b"1e999", b"0.1", b"-0.0", b"nan", b"inf", b"-inf", b"1" + 400 * b"0",
    b"9" * 4400, b"0x10", b"1_000", b"00", b"1e5",
)  # fmt: skip
ODD = (0, 1, 9, 10, 13, 0x20, 0x22, 0x23, 0x27, 0x2E, 0x5B, 0x5D, 0x7F, 0x80, 0xC0, 0xFF)


def mutate(data, rng, tokens, corpus, most):
    """Another input of at most `most` bytes, one to four steps from `data`."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 3, 4))):
        out = _step(out, rng, tokens, corpus)
    return bytes(out[:most])


def _step(data, rng, tokens, corpus):
    size = len(data)
    at = rng.randrange(size + 1)
    end = min(size, at + rng.choice((1, 1, 2, 4, 8, 32)))
    kind = rng.randrange(12)
    if kind == 0 and at < size:
        data[at] ^= 1 << rng.randrange(8)
    elif kind == 1 and at < size:
        data[at] = rng.choice(ODD) if rng.random() < 0.5 else rng.randrange(256)
    elif kind == 2:
        del data[at:end]
    elif kind == 3:
        data[at:at] = data[at:end] * rng.choice((1, 2, 20))
    elif kind in (4, 5):
        data[at:at] = rng.choice(tokens)
    elif kind in (6, 7):
        _replace(data, rng, _NUMBER, NUMBERS)
    elif kind == 8:
        _replace(data, rng, _WORD, tokens)
    elif kind == 9:
        data[at:at] = bytes(rng.randrange(256) for _ in range(rng.randrange(1, 9)))
    elif kind == 10:
        other = rng.choice(corpus)
        data[at:] = other[rng.randrange(len(other) + 1) :]
    else:
        lines = data.split(b"\n")
        k, m = rng.randrange(len(lines)), rng.randrange(len(lines))
        if rng.random() < 0.3:
            del lines[k]
        elif rng.random() < 0.5:
            lines.insert(m, lines[k])
        else:
            lines[k], lines[m] = lines[m], lines[k]
        return bytearray(b"\n".join(lines))
    return data


def _replace(data, rng, what, by):
    """One match, anywhere, by another word."""
    if not data:
        return
    match = what.search(data, rng.randrange(len(data))) or what.search(data)
    if match:
        data[match.start() : match.end()] = rng.choice(by)

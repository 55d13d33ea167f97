"""The prose linter finds what it is for, where it is, and nothing in code, tables and links."""

import pytest

from tests.docs.prose import LONG, SHORT, explanations, lint, pages, run, words

WORDS = " ".join(f"{first}{second}x" for first in "abcdef" for second in "ghjkl")


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("A frame that is none is dropped.", "'that is none'"),
        ("The number for who is first.", "'for who'"),
        ("What the gateway Believes is sent.", "'Believes'"),
        ("The flag is\nsaid to be good.", "is\nsaid"),
        ("The flag is said to be good.", "'is said'"),
        ("The frame frame was lost.", "lexical illusion"),
        (f"The {WORDS} ends.", "32 words"),
    ],
)
def test_a_bad_sentence_is_found_in_its_line(text, what):
    found = lint("page.md", f"# Heading\n\nA good sentence.\n{text}\n", SHORT)
    assert [line.split(": ")[0] for line in found] == ["page.md:4"]
    assert what in found[0]


@pytest.mark.parametrize(
    "text",
    [
        f"```\n{WORDS} frame frame\n```", f"| {WORDS} | is said |", f"# {WORDS}",
        f"A good `{WORDS} that is none` sentence.", f"A good [one](docs/{'is-said/' * 30}x.md).",
        f"{WORDS[:75]}: {WORDS[:75]}; {WORDS[:75]}.", f"- {WORDS[:75]}\n- {WORDS[:75]}",
    ],
)  # fmt: skip
def test_code_tables_and_links_are_no_prose(text):
    assert lint("page.md", f"Begin.\n\n{text}\n", SHORT) == []


def test_what_a_visitor_reads_has_short_sentences():
    most = {path.name: words for path, words in pages()}
    assert (most["README.md"], most["replay.md"], most["thermal.md"]) == (SHORT, SHORT, LONG)


def test_of_a_source_only_docstrings_and_comments_are_read(tmp_path):
    python, c = tmp_path / "x.py", tmp_path / "x.c"
    python.write_text('"""A\n\nword that is none."""\n\nheard = "heard"  # who asks\n')
    c.write_text("int heard;\n/* A frame is\n * said to be good. */\nint believed; /* heard */\n")
    for path, lines in ((python, ["3", "5"]), (c, ["2", "4"])):
        found = run(path.name, explanations(path), [words()])
        assert [line.split(":")[1] for line in found] == lines

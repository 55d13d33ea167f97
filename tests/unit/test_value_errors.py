"""Messages about values of a wrong type: what was expected, with its unit, and what is there."""

from typing import Literal

import pytest
from pydantic import BaseModel, Field, ValidationError

from dbc.value_errors import wording


class Part(BaseModel):
    x: int = 1


class Whole(BaseModel):
    at_s: float = 0.0
    load_nm: float = 0.0
    count: int = Field(1, gt=0, lt=9)
    kind: Literal["rail", "preset"] = "rail"
    on: bool = False
    title: str = ""
    part: Part = Part()
    parts: list[Part] = []
    many: tuple[Part, ...] = ()
    L_s: float = 1.0
    name: str = Field("x", min_length=1)
    signal: str = Field("A.B", pattern=r"^\w+\.\w+$")
    rates: tuple[float, ...] = Field((1.0,), min_length=1, max_length=2)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"at_s": "2 s"}, "expected a number of seconds, got '2 s': write it without quotes and "
         "unit"),
        ({"load_nm": "much"}, "expected a number of Nm, got 'much'"),
        ({"load_nm": [1]}, "expected a number of Nm, got a list"),
        ({"count": 1.5}, "expected a whole number, got 1.5"),
        ({"count": 0}, "expected more than 0, got 0"),
        ({"count": 9}, "expected less than 9, got 9"),
        ({"kind": "rial"}, "expected 'rail' or 'preset', got 'rial'; did you mean 'rail'?"),
        ({"on": 5}, "expected true or false, got 5"),
        ({"title": True}, "expected text in quotes, got true"),
        ({"part": "x"}, "expected a table, got 'x': write [part], and its keys below"),
        ({"part": [{}]}, "expected a table, got a list"),
        ({"parts": {}}, "expected a list, got a table: write [[parts]]"),
        ({"many": {}}, "expected a list, got a table: write [[many]]"),
        ({"many": "x"}, "expected a list, got 'x': write it in [ ]"),
        ({"L_s": "1 H"}, "expected a number, got '1 H': write it without quotes and unit"),
        ({"name": ""}, "expected a text that is not empty, got ''"),
        ({"signal": "A B"}, "expected 'MESSAGE.SIGNAL', got 'A B'"),
        ({"rates": []}, "expected 1 or more entries, got a list"),
        ({"rates": [1, 2, 3]}, "expected no more than 2 entries, got a list"),
        ({"kind": "x" * 99}, f"expected 'rail' or 'preset', got '{'x' * 47}.."),
    ],
)  # fmt: skip
def test_a_message_has_what_was_expected_and_what_is_there(given, message):
    with pytest.raises(ValidationError) as caught:
        Whole.model_validate(given)
    assert [wording(item) for item in caught.value.errors()] == [message]

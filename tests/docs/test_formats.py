"""The table of what each format keeps is what the formats keep."""

from tests.docs.formats import MARK, PAGE, table


def test_the_table_in_the_page_is_what_comes_back():
    _, made, _ = PAGE.read_text(encoding="utf-8").split(MARK)
    assert made.strip() == table()

"""Plain data goes through TOML text unchanged."""

import tomllib

from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.marine.simulation.toml_text import toml_text

NAMES = st.text(max_size=8)
VALUES = st.recursive(
    st.booleans()
    | st.integers(-(2**62), 2**62)
    | st.floats(allow_nan=False)
    | st.text(st.characters(exclude_categories=["Cs"]), max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.from_regex(r"[a-z\-é. ]{1,4}", fullmatch=True), inner)
    ),
    max_leaves=12,
)
TABLES = st.dictionaries(st.from_regex(r"[A-Za-z0-9_\-é.\" ]{1,5}", fullmatch=True), VALUES, max_size=5)


@settings(max_examples=20)
@given(TABLES)
def test_it_reads_back_to_the_last_bit(table):
    assert tomllib.loads(toml_text(table)) == table


def test_tables_of_tables_have_heads_of_their_own():
    text = toml_text({"a": [{"b": 1, "c": {"d": 0.1}}, {"b": 2}], "e": 3})
    assert text.splitlines() == ["e = 3", "", "[[a]]", "b = 1", "", "[a.c]", "d = 0.1", "", "[[a]]", "b = 2"]

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.recorded import read_recorded, read_unnamed, shown


def written(folder: Path, content: bytes | str, name: str = "a.csv") -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


SAME = {
    "plain": b"a,b\n1,2\n3,4\n",
    "byte-order mark": b"\xef\xbb\xbfa,b\n1,2\n3,4\n",
    "CRLF": b"a,b\r\n1,2\r\n3,4\r\n",
    "old Mac": b"a,b\r1,2\r3,4\r",
    "no last newline": b"a,b\n1,2\n3,4",
    "quotes": b'"a","b"\n"1","2"\n3,"4"\n',
    "blank lines and spaces": b"\n a , b\n 1, 2 \n\n ,\n3,4\n\n",
}


@pytest.mark.parametrize("text", ["x", 'kind = "scenario"\npath_m = [[1, 2], [3, 4]]\n'])
def test_a_file_that_is_no_table(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"a\.csv: is not a table: its first line has one cell"):
        read_recorded(written(tmp_path, text))


@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"], ids=["LF", "CRLF", "CR"])
def test_comments_and_lines_with_any_line_ends(tmp_path: Path, ends: str) -> None:
    text = "# frame=ned\n# tank\na,b\n\n1,2\n3,x\n".replace("\n", ends)
    table = read_recorded(written(tmp_path, text))
    assert table.about == ("frame=ned", "tank") and table.lines.tolist() == [5, 6]
    with pytest.raises(InputError, match=r"a\.csv:6: b = 'x'"):
        table.numbers("b")
    with pytest.raises(InputError, match=r"a\.csv:3: is separated by semicolons"):
        read_recorded(written(tmp_path, f"# one{ends}# two{ends}a;b{ends}1;2{ends}"))
    with pytest.raises(InputError, match=r"a\.csv:2: is not text"):
        read_recorded(written(tmp_path, b"a" + ends.encode() + b"\xff"))


@pytest.mark.parametrize(
    ("cell", "remedy"),
    [
        ("1,000", "write 1000 if the comma separates thousands, 1.000 if it is a decimal comma"),
        ("-12,345", "write -12345 if the comma separates thousands, -12.345 if it is a decimal comma"),
        ("1,234,567", "write 1234567 without commas between thousands"),
        ("1,234.5", "write 1234.5 without commas between thousands"),
        ("1,5", "write a decimal point"),
        ("0,125", "write a decimal point"),
        ("12,3456", "write a decimal point"),
        ("1 m", "write a number, or leave the cell empty"),
    ],
)
def test_the_remedy_does_not_change_what_a_number_is(tmp_path: Path, cell: str, remedy: str) -> None:
    table = read_recorded(written(tmp_path, f'a,b\n"{cell}",1\n'))
    with pytest.raises(InputError) as caught:
        table.numbers("a")
    assert str(caught.value).endswith(f"is not a number; {remedy}")


@pytest.mark.parametrize("case", SAME)
def test_ways_to_write_one_table(tmp_path: Path, case: str) -> None:
    table = read_recorded(written(tmp_path, SAME[case]))
    assert list(table.columns) == ["a", "b"]
    assert table.numbers("a").tolist() == [1.0, 3.0] and table.numbers("b").tolist() == [2.0, 4.0]


def test_lines_are_those_of_the_file(tmp_path: Path) -> None:
    table = read_recorded(written(tmp_path, "a\n\n1\n2\n\nx\n"))
    assert table.lines.tolist() == [3, 4, 6]
    with pytest.raises(InputError, match=r"a\.csv:6: a = 'x': is not a number"):
        table.numbers("a")


def test_cells_without_a_number_are_nan(tmp_path: Path) -> None:
    table = read_recorded(written(tmp_path, "a,b\n,1\nNaN,1\ninf,1\n-Infinity,1\nn/a,1\nNULL,1\n1e400,1\n2.5,1\n"))
    assert np.isnan(table.numbers("a")).tolist() == [True] * 7 + [False]


REFUSED = {
    "empty": (b"", "is empty"),
    "only a mark": (b"\xef\xbb\xbf\n\n", "is empty"),
    "no rows": (b"a,b\n\n", "has no rows; add rows below the names"),
    "no header": (b"1,2\n3,4\n", "a.csv:1: has no header"),
    "a column twice": (b"a,b,a\n1,2,3\n", "'a' appears twice"),
    "a cell too many": (b"a,b\n1,2\n1,2,3\n", "a.csv:3: has 3 cells, but the header has 2"),
    "a cell too few": (b"a,b\n1\n", "a.csv:2: has 1 cells"),
    "semicolons": (b"a;b\n1,5;2\n", "semicolons; save it with commas"),
    "tabs": (b"a\tb\n1\t2\n", "tabs; save"),
    "Latin-1": ("a,b\n1,2\n1,°\n".encode("latin-1"), r"a.csv:3: is not text \(UTF-8\)"),
    "UTF-16": ("a,b\n1,2\n".encode("utf-16"), "is not text"),
    "NUL": (b"a,b\n1,\x00\n", "NUL"),
    "an open quote": (b'a,b\n1,2\n"1,2\n3,4\n', "is not CSV"),
    "a cell without end": (b"a,b\n1," + b"2" * 200_000 + b"\n", "is not CSV"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_table_is_refused(tmp_path: Path, case: str) -> None:
    content, words = REFUSED[case]
    with pytest.raises(InputError, match=words) as caught:
        read_recorded(written(tmp_path, content))
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


@pytest.mark.parametrize("cell", ["1_5", "1,5", "0x10", "1 m", "ten", "--1"])
def test_text_is_no_number(tmp_path: Path, cell: str) -> None:
    with pytest.raises(InputError, match="is not a number"):
        read_recorded(written(tmp_path, f'a,b\n1,2\n"{cell}",2\n')).numbers("a")


def test_a_missing_column_names_the_nearest(tmp_path: Path) -> None:
    table = read_recorded(written(tmp_path, "true_m,measurd_m\n1,2\n"))
    table.need(["true_m"])
    with pytest.raises(InputError, match="'measured_m' is missing; did you mean 'measurd_m'"):
        table.need(["true_m", "measured_m"])


def test_folder_missing_file_and_odd_names(tmp_path: Path) -> None:
    for path, words in (
        (tmp_path, "cannot be read"),
        (tmp_path / "no.csv", "no such file"),
        (Path("a\0b"), "cannot be"),
    ):
        with pytest.raises(InputError, match=words):
            read_recorded(path)
    odd = written(tmp_path, "a\n1\n", "o\"d'd\n.csv")
    assert "\n" not in read_recorded(odd).name and "\"d'd" in read_recorded(odd).name
    assert shown("a\udcffb\t") == "a?b?"


def test_many_rows_are_read_within_bounds(tmp_path: Path) -> None:
    path = written(tmp_path, "a,b\n" + "1.25,2.5\n" * 20_000)
    tracemalloc.start()
    table = read_recorded(path)
    assert table.numbers("a").sum() == 2.5e4
    assert tracemalloc.get_traced_memory()[1] < 12e6  # 0.6 kB a row
    tracemalloc.stop()


@given(st.binary(max_size=200))
def test_any_bytes_are_a_table_or_one_line(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = written(tmp_path_factory.getbasetemp(), content, "fuzz.csv")
    try:
        table = read_recorded(path)
        for column in table.columns:
            assert len(table.numbers(column)) == len(table.lines)
    except InputError as error:
        assert "\n" not in str(error)


@given(st.text(alphabet="a1,;\"'\r\n\t -.e\ufeff", max_size=60))
def test_any_text_is_a_table_or_one_line(tmp_path_factory: pytest.TempPathFactory, content: str) -> None:
    path = written(tmp_path_factory.getbasetemp(), "a,b\n" + content, "fuzz2.csv")
    try:
        table = read_recorded(path)
        assert all(len(cells) == len(table.lines) for cells in table.columns.values())
    except InputError as error:
        assert "\n" not in str(error)


def test_comments_above_the_header_are_kept_apart(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text('# frame=ned, "a quote\n## more\na,b\n1,2\n3,x\n', encoding="utf-8")
    table = read_recorded(path)
    assert table.about == ('frame=ned, "a quote', "more")
    np.testing.assert_array_equal(table.numbers("a"), [1.0, 3.0])
    with pytest.raises(InputError, match=r"log\.csv:5: b = 'x'"):
        table.numbers("b")


@pytest.mark.parametrize("mark", ["sep=,", '"sep=,"', "SEP=,", "sep=,,"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_first_line_that_names_the_separator_is_no_header(mark: str, end: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes((end.join([mark, "t_s,x_m", "0,1.5", "1,fast"]) + end).encode())
    table = read_recorded(path)
    assert table.columns == {"t_s": ["0", "1"], "x_m": ["1.5", "fast"]}
    with pytest.raises(InputError, match=r"a.csv:4: x_m = 'fast'"):
        table.numbers("x_m")
    path.write_bytes(end.join(["sep=;", "t_s;x_m", "0;1,5"]).encode())
    with pytest.raises(InputError, match=r"a.csv:2: is separated by semicolons"):
        read_recorded(path)
    path.write_bytes(end.join([mark, "0,1.5"]).encode())
    assert read_unnamed(path, ["t", "x"]).columns == {"t": ["0"], "x": ["1.5"]}

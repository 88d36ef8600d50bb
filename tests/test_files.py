"""Reading and writing files: whatever is wrong becomes one line."""

from __future__ import annotations

import os
import resource
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from pydantic import Field, model_validator

from surctl.errors import InputError
from surctl.files import Quantity, Strict, changes, load_model, pick, read_toml, validate, write_file


class _Part(Strict):
    mass_kg: float = Field(gt=0)
    label: str = ""


class _Thing(Strict):
    name: str
    part: _Part
    spare: tuple[_Part, ...] = ()


def test_a_file_read_again_is_a_table_of_its_own_and_a_changed_one_is_read_anew(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    path.write_text('[site]\ndepth_m = "150 cm"\nwalls = [1]')
    table = read_toml(path)
    table["site"]["walls"].append(2)
    assert read_toml(path) == {"site": {"depth_m": 1.5, "walls": [1]}}
    path.write_text("[site]\ndepth_m = 2.0")
    assert read_toml(path) == {"site": {"depth_m": 2.0}}


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "is empty"),
        (b"# a comment only\n", "is empty"),
        (b"\x7fELF\x02\x01\xff\xfe", "is not text (UTF-8)"),
        (b'a = "\x00"', "NUL byte"),
        (b"a = \n", "is not valid TOML"),
        (b"a = 1\na = 2\n", "is not valid TOML"),
    ],
    ids=["empty", "comment", "binary", "nul", "syntax", "twice"],
)
def test_a_file_that_is_no_table_is_one_line(tmp_path: Path, content: bytes, problem: str) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_toml(path)
    text = str(caught.value)
    assert problem in text
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    assert caught.value.remedy


def test_a_missing_file_and_a_directory(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_toml(tmp_path / "absent.toml")
    with pytest.raises(InputError, match="cannot be read"):
        read_toml(tmp_path)


@settings(derandomize=True, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_a_table_or_an_input_error(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.mktemp("any") / "a.toml"
    path.write_bytes(content)
    try:
        assert read_toml(path)
    except InputError as error:
        assert len(str(error).splitlines()) == 1


def _mistake(table: dict[str, object]) -> InputError:
    with pytest.raises(InputError) as caught:
        validate(table, _Thing, file="a.toml")
    assert str(caught.value).startswith("a.toml: ")
    assert "\n" not in str(caught.value)
    return caught.value


def test_a_missing_key() -> None:
    error = _mistake({"name": "a", "part": {}})
    assert (error.key, error.problem, error.remedy) == ("part.mass_kg", "is missing", "add it")


def test_an_unknown_key_names_the_nearest_known_one_and_comes_before_the_missing_one() -> None:
    error = _mistake({"name": "a", "part": {"mas_kg": 1.0}})
    assert error.key == "part.mas_kg"
    assert error.problem == "unknown key (also wrong: part.mass_kg)"
    assert error.remedy == "did you mean 'mass_kg'?"


def test_an_unknown_key_inside_a_list_is_looked_up_in_the_list_entry() -> None:
    error = _mistake({"name": "a", "part": {"mass_kg": 1.0}, "spare": [{"mass_kg": 1.0, "lable": "x"}]})
    assert error.key == "spare.0.lable"
    assert error.remedy == "did you mean 'label'?"


def test_a_list_of_one_wrong_member_is_one_mistake() -> None:
    class Shelf(Strict):
        things: tuple[_Thing, ...] = Field(min_length=1)

    with pytest.raises(InputError) as caught:
        validate({"things": [{"name": "a", "part": {}}]}, Shelf, file="a.toml")
    assert (caught.value.key, caught.value.problem) == ("things.0.part.mass_kg", "is missing")
    with pytest.raises(InputError, match="at least 1 item"):
        validate({"things": []}, Shelf, file="a.toml")


def test_a_mistake_of_the_whole_file_has_no_key() -> None:
    class Pair(Strict):
        low: float
        high: float

        @model_validator(mode="after")
        def _ordered(self) -> Pair:
            if self.low > self.high:
                raise ValueError("low is above high; swap them")
            return self

    with pytest.raises(InputError) as caught:
        validate({"low": 2.0, "high": 1.0}, Pair, file="a.toml")
    assert str(caught.value) == "a.toml: low is above high; swap them"


@pytest.mark.parametrize("value", [-1.0, 0.0, float("nan"), float("inf"), "heavy", [1.0]])
def test_a_wrong_value_is_shown(value: object) -> None:
    error = _mistake({"name": "a", "part": {"mass_kg": value}})
    assert error.key == "part.mass_kg"
    assert repr(value) in str(error)
    assert error.remedy


def test_a_quantity_is_a_number_with_a_unit() -> None:
    assert validate({"value": 2, "unit": "kg"}, Quantity, file="a").value == 2.0
    for value in (True, "2"):
        with pytest.raises(InputError, match="value"):
            validate({"value": value, "unit": "kg"}, Quantity, file="a")


def test_load_model_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "thing.toml"
    path.write_text('name = "a"\n[part]\nmass_kg = 2.5\n')
    assert load_model(path, _Thing).part.mass_kg == 2.5
    path.write_text('name = "a"\n')
    with pytest.raises(InputError, match=r"thing\.toml: part: is missing"):
        load_model(path, _Thing)


def test_models_are_frozen() -> None:
    with pytest.raises(ValueError, match="frozen"):
        validate({"mass_kg": 1.0}, _Part, file="a").mass_kg = 2.0


def test_pick_prefers_the_library_and_takes_anything_with_a_suffix_or_separator_as_a_path(tmp_path: Path) -> None:
    (tmp_path / "ball.toml").write_text("a = 1")
    assert pick("ball", tmp_path, what="thing") == tmp_path / "ball.toml"
    assert pick("own.toml", tmp_path, what="thing") == Path("own.toml")
    assert pick("some/where", tmp_path, what="thing") == Path("some/where")
    with pytest.raises(InputError, match="unknown thing; did you mean 'ball'"):
        pick("bal", tmp_path, what="thing")


def test_a_file_is_written_whole_or_left_as_it_was(tmp_path: Path) -> None:
    target = tmp_path / "new" / "gains.toml"
    assert write_file(target, "k = 1\n") == target and target.read_bytes() == b"k = 1\n"
    room = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, room[1]))
    try:
        with pytest.raises(InputError, match=r"gains\.toml: cannot be written \(File too large\); free disk space"):
            write_file(target, b"x" * 2000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, room)
    assert target.read_bytes() == b"k = 1\n" and [p.name for p in target.parent.iterdir()] == ["gains.toml"]
    with pytest.raises(InputError, match="cannot be written"):
        write_file(target / "below", "")
    link = tmp_path / "link.toml"
    link.symlink_to(target)
    write_file(link, "k = 2\n")
    assert link.is_symlink() and target.read_bytes() == b"k = 2\n"
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match=r"pipe: cannot be written \(no regular file\); choose another name"):
        write_file(tmp_path / "pipe", "")


class _Numbers(Strict):
    one: float | None = None
    more: tuple[float, ...] = ()
    named: dict[str, float] = Field(default_factory=dict)
    count: int = 0
    switch: bool | float = False


@pytest.mark.parametrize(
    ("key", "value", "place"),
    [
        ("one", True, "one"),
        ("count", False, "count"),
        ("more", [1.0, True], "more.1"),
        ("named", {"a": True}, "named.a"),
    ],
)
def test_a_boolean_is_no_number(key: str, value: object, place: str) -> None:
    with pytest.raises(InputError, match=rf"f\.toml: {place} = (True|False): must be a number; write it in digits"):
        validate({key: value}, _Numbers, file="f.toml")
    assert validate({"switch": True, "one": 1}, _Numbers, file="f.toml").switch is True


def test_the_command_that_a_picture_names_is_no_part_of_its_contents(tmp_path: Path) -> None:
    def draw(colour: str, command: str) -> None:
        text = PngInfo()
        text.add_text("Software", "surctl.report")
        text.add_text("Description", command)
        Image.new("RGB", (9, 9), colour).save(tmp_path / "run.png", pnginfo=text)

    draw("red", "surctl simulate pond.toml --out plots")
    changed = changes(tmp_path)
    draw("red", "surctl simulate ./pond.toml --out ../pond/plots --verbose")
    assert changed() == []
    draw("blue", "surctl simulate pond.toml --out plots")
    assert changed() == ["run.png"]

"""Gain files: every gain there, of the right sign, and exactly what was written."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.marine.control import GAINS, LIBRARY, Gains, load_gains, write_gains

TEXT = (LIBRARY / "default.toml").read_text(encoding="utf-8")
BOUNDED = {"brake": 1.0, "lms_step": 1.0, "beta_max": 0.5}
MAY_BE_ZERO = {"k_i", "delta", "lambda1", "beta_max", "spin", "patience"}


def _load(folder: Path, text: str) -> Gains:
    path = folder / "own.toml"
    path.write_text(text, encoding="utf-8")
    return load_gains(str(path))


def _with(name: str, value: str) -> str:
    text, count = re.subn(rf"^{name} = {{ value = [-0-9.e]+", f"{name} = {{ value = {value}", TEXT, flags=re.M)
    assert count == 1
    return text


def test_the_default_set_is_complete_and_says_where_it_comes_from() -> None:
    gains = load_gains("default")
    assert list(gains.values) == list(GAINS)
    assert gains.name == "default"
    assert gains.provenance


def test_which_gains_may_be_zero_or_are_bounded() -> None:
    assert {name for name, spec in GAINS.items() if spec.zero_allowed} == MAY_BE_ZERO
    assert {name: pytest.approx(spec.below) for name, spec in GAINS.items() if spec.below < 1e9} == BOUNDED


@pytest.mark.parametrize(
    ("name", "value"),
    [(name, value) for name in GAINS for value in ("0.0", "nan")]
    + [("k_v", value) for value in ("-1.0", "inf", "-inf", "true", '"1"')],
)
def test_a_gain_that_is_not_positive_is_refused(tmp_path: Path, name: str, value: str) -> None:
    if value == "0.0" and name in MAY_BE_ZERO:
        assert _load(tmp_path, _with(name, value))[name] == 0.0
        return
    with pytest.raises(InputError) as caught:
        _load(tmp_path, _with(name, value))
    shown = str(caught.value)
    assert shown.startswith(f"{tmp_path / 'own.toml'}: gains.{name}")
    assert caught.value.remedy
    assert "\n" not in shown


@pytest.mark.parametrize(("name", "most"), BOUNDED.items())
def test_upper_bounds(tmp_path: Path, name: str, most: float) -> None:
    assert _load(tmp_path, _with(name, str(most)))[name] == most
    with pytest.raises(InputError, match=f"at most {most:g}"):
        _load(tmp_path, _with(name, str(most + 0.01)))


@pytest.mark.parametrize("name", [name for name, spec in GAINS.items() if spec.default is not None])
def test_a_gain_with_a_default_may_be_left_out(tmp_path: Path, name: str) -> None:
    loaded = _load(tmp_path, re.sub(rf"^{name} = .*\n", "", TEXT, flags=re.M))
    assert loaded[name] == GAINS[name].default == load_gains("default")[name]


@pytest.mark.parametrize("name", [name for name, spec in GAINS.items() if spec.default is None])
def test_every_other_gain_must_be_there(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=rf"gains\.{name}: is missing; add {name} = "):
        _load(tmp_path, re.sub(rf"^{name} = .*\n", "", TEXT, flags=re.M))


@pytest.mark.parametrize(
    ("old", "new", "fragment"),
    [
        ("lookahead =", "lokahead =", "gains.lokahead: no such gain; did you mean 'lookahead'?"),
        ('lookahead = { value = 0.8, unit = "m" }', 'lookahead = { value = 0.8, unit = "s" }', "give it in m"),
        ("lookahead = { value = 0.8", "lookahead = { valeu = 0.8", "did you mean 'value'?"),
        ('kind = "gains"', 'kind = "vehicle"', "kind = 'vehicle'"),
        ("[gains]", "[gain]", "did you mean 'gains'?"),
        ('name = "default"', 'name = ""', "name = ''"),
    ],
    ids=["unknown gain", "wrong unit", "typo inside", "another kind", "unknown table", "no name"],
)
def test_other_mistakes_are_one_line(tmp_path: Path, old: str, new: str, fragment: str) -> None:
    assert TEXT.count(old) == 1
    with pytest.raises(InputError) as caught:
        _load(tmp_path, TEXT.replace(old, new))
    assert fragment in str(caught.value)
    assert str(tmp_path / "own.toml") in str(caught.value)
    assert "\n" not in str(caught.value)


def _allowed(name: str) -> st.SearchStrategy[float]:
    spec = GAINS[name]
    return st.floats(0 if spec.zero_allowed else 1e-300, min(spec.below, 1e300))


@settings(derandomize=True, deadline=None)
@given(
    st.fixed_dictionaries({name: _allowed(name) for name in GAINS}), st.text(st.characters(codec="ascii"), min_size=1)
)
def test_what_is_written_reads_back_exactly(
    tmp_path_factory: pytest.TempPathFactory, values: dict[str, float], provenance: str
) -> None:
    if any(ord(c) < 32 or ord(c) == 127 for c in provenance):
        return  # control characters are no part of a provenance
    gains = replace(load_gains("default").with_values(values), name="swept", provenance=provenance)
    back = _load(tmp_path_factory.mktemp("gains"), write_gains(gains))
    assert back.values == gains.values
    assert (back.name, back.provenance) == ("swept", provenance)


def test_ranges_are_written_as_long_as_the_value_is_inside(tmp_path: Path) -> None:
    gains = replace(load_gains("default"), ranges={"k_v": (1.0, 2.0), "k1": (0.1, 0.3)})
    back = _load(tmp_path, write_gains(gains.with_values({"k_v": 2.5})))
    assert back["k_v"] == 2.5 and back.ranges == {"k1": (0.1, 0.3)}


def test_with_values_checks_and_leaves_the_original() -> None:
    gains = load_gains("default")
    changed = gains.with_values({"k1": 0.5}, provenance="swept")
    assert (changed["k1"], gains["k1"], changed.provenance) == (0.5, 0.3, "swept")
    assert changed["k2"] == gains["k2"]
    with pytest.raises(InputError, match=r"gains\.k1 = 0\.0"):
        gains.with_values({"k1": 0.0})
    with pytest.raises(InputError, match="no such gain; did you mean 'k_psi'"):
        gains.with_values({"kpsi": 1.0})
    with pytest.raises(InputError, match="no such gain"):
        gains["nothing"]

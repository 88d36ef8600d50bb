"""What a vehicle file does not state is listed, with the margin at half and at double of what is assumed."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surctl.assessment import assess
from surctl.marine.assessment import Mission, assumptions
from surctl.marine.control import build_law, load_gains
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.marine.vehicle.specs import DEFAULTED
from surctl.marine.verification import law_corners
from surctl.marine.verification.corners import corners
from tests.cli.process import surctl_here

GAINS = load_gains("default")


def drawn(seed: int) -> Vehicle:
    """A vehicle that states no thrust lag; seeds that are odd state no ranges either."""
    rng = np.random.default_rng(seed)
    vehicle = load_vehicle("sur400").with_values({"m44": float(rng.uniform(0.5, 1.0))})
    lag = replace(
        vehicle.parameters["thrust_lag"], value=float(rng.uniform(0.1, 0.4)), provenance=DEFAULTED, range=None
    )
    parameters = {**vehicle.parameters, "thrust_lag": lag}
    if not seed % 2:
        mass = parameters["m33"]
        parameters["m33"] = replace(mass, range=(0.9 * mass.value, 1.1 * mass.value))
    return replace(vehicle, parameters=parameters)


@pytest.mark.parametrize("seed", range(2))
def test_each_default_is_listed_with_its_influence(seed: int) -> None:
    vehicle = drawn(seed)
    result = assess(Mission(vehicle, GAINS, 0.15, 0.22), parts=["loop"])
    assert [one.name for one in result.assumptions] == ["thrust_lag", *(["ranges"] if seed % 2 else [])]
    lag = vehicle["thrust_lag"]
    for share, margin in zip((0.5, 1.0, 2.0), result.assumptions[0].margins, strict=True):
        tried = corners(vehicle.with_values({"thrust_lag": share * lag}))
        assert margin == law_corners(build_law(), tried, GAINS, cruise=0.15, proved=False).disk
    assert result.assumptions[0].margins[1] == pytest.approx(result.figures["disk_margin"].value, rel=5e-3)
    for one in result.assumptions:
        assert one.margins[0] >= one.margins[1] >= one.margins[2]
        assert [line.counts for line in result.lines if line.text == one.text] == [False]
    assert [one["name"] for one in result.to_dict()["assumptions"]] == [one.name for one in result.assumptions]
    # an uncertainty that is stated takes the place of the ranges
    assert [one.name for one in assumptions(vehicle, uncertainty=0.1)] == ["thrust_lag"]


def test_lint_of_several_files_lists_the_defaults_of_each(tmp_path: Path) -> None:
    assert surctl_here("new", "vehicle", "mine", cwd=tmp_path).status == 0
    text = (tmp_path / "mine.toml").read_text()
    assert 'thrust_lag = "0.3 s"\n' in text
    (tmp_path / "less.toml").write_text(text.replace('thrust_lag = "0.3 s"\n', ""))
    alone = json.loads(surctl_here("lint", "mine.toml", "--json", cwd=tmp_path).out)
    both = surctl_here("lint", "mine.toml", "less.toml", "--json", cwd=tmp_path)
    assert both.status == 0
    first, second = json.loads(both.out)["files"]
    assert {**first, "next": alone["next"]} == alone and first["findings"] == []
    assert [(found["level"], found["key"]) for found in second["findings"]] == [("info", "thrust_lag")]
    assert "0.3 s" in second["findings"][0]["text"]
    text = surctl_here("lint", "mine.toml", "less.toml", cwd=tmp_path).out
    assert text.index("mine.toml:") < text.index("nothing found") < text.index("less.toml:") < text.index("thrust_lag")
    (tmp_path / "bad.toml").write_text('kind = "vehicle"\nname = "bad"\n')
    assert surctl_here("lint", "mine.toml", "bad.toml", cwd=tmp_path).status == 2

"""`--barrier` and `--movers`, and the safety claim that `verify --scenario` prints."""

from __future__ import annotations

import re
from pathlib import Path

from tests.cli.process import surctl, surctl_here


def test_verify_prints_the_safety_claim_and_fails_where_it_does_not_hold(tmp_path: Path) -> None:
    common = ("verify", "braking-mass", "--scenario", "tank-static")
    near = surctl(*common, "--uncertainty", "0.2", "--json", cwd=tmp_path)
    assert near.json["safety"]["holds"] is True and "failures" not in near.json
    assert near.status == 0
    assert {row["name"] for row in near.json["safety"]["assumptions"]} >= {"thrust lag", "obstacle speed"}
    wide = surctl(*common, cwd=tmp_path)
    assert wide.status == 1 and "DOES NOT HOLD" in wide.out
    (reason,) = [line for line in wide.out.splitlines() if line.startswith("NOT accepted: ")]
    assert "no contact in tank-static by sonar does not hold: braking needs a margin of" in reason


def test_mistakes_are_named(tmp_path: Path) -> None:
    for command in (("simulate", "tank-static"), ("export",), ("verify", "braking-mass", "--scenario", "tank-static")):
        done = surctl_here(*command, "--barrier", "inertial", cwd=tmp_path)
        assert done.status != 0 and "did you mean 'inertia'" in done.complaint


def test_derived_gains_are_judged_for_the_braking_model_of_the_law(tmp_path: Path) -> None:
    """The gain `margin` that suffices depends on the braking model; the next commands are about the same model."""
    words = ("gains", "derive", "sur540-flooded", "--cruise", "0.2", "--margin", "0.01")
    needed = {}
    for barrier in ("simple", "inertia"):
        done = surctl_here(*words, "--barrier", barrier, "--out", f"{barrier}.toml", "--verbose", cwd=tmp_path)
        assert f"(true positions, barrier {barrier}): braking needs a margin of" in done.out
        option = "" if barrier == "simple" else " --barrier inertia"
        margin = re.search(
            rf"surctl gains derive .* --margin ([\d.]+){option} --out {barrier}.toml --force\n", done.out
        )
        assert margin, done.out
        needed[barrier] = float(margin[1])
        assert f"surctl verify --vehicle sur540-flooded{option} --gains {barrier}.toml --cruise 0.2" in done.out
    assert needed["inertia"] < needed["simple"]
    assert "did you mean 'inertia'" in surctl_here(*words, "--barrier", "inertial", cwd=tmp_path).complaint

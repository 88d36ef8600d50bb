from __future__ import annotations

from pathlib import Path

import pytest

from surctl.errors import InputError
from surctl.lyapunov import load_problem, solve
from tests.lyapunov.problems import DECAY, MAP, VAN_DER_POL, written


@pytest.mark.parametrize(
    ("text", "old", "new", "says"),
    [
        (VAN_DER_POL, 'rate = "-y"', 'next = "-y"', "states.x: needs rate, and not next"),
        (VAN_DER_POL, 'rate = "-y"', 'rate = "-z"', "'z' at column 2 is not known"),
        (VAN_DER_POL, "mu = 1.0", "x = 1.0", "constants.x: is defined twice"),
        (VAN_DER_POL, "level = 2.0", "level = -2.0", "level = -2.0: is not positive"),
        (VAN_DER_POL, "level = 2.0", "level = nan", "level"),
        (VAN_DER_POL, 'function = "1.5*x^2 - x*y + y^2"\n', "", "level: is given without function"),
        (VAN_DER_POL, "lower = -3, upper = 3, unit = \"m\"", "lower = 3, upper = -3", "needs finite bounds"),
        (VAN_DER_POL, 'unit = "m"', 'unit = "m\\n"', "a unit that cannot be printed"),
        (VAN_DER_POL, 'unit = "m/s"', "equilibrium = 4", "van-der-pol.y = 4.0: has its equilibrium outside its bounds"),
        (VAN_DER_POL, "level = 2.0", 'unsafe = ["x >= 1"]', "unsafe: belongs to kind barrier"),
        (VAN_DER_POL, "x = {", "sin = {", "states.sin: is not a name for an expression"),
        (MAP, "rate = 0.2", "rate = 1.2", "rate = 1.2: exceeds 1"),
        (DECAY, 'unsafe = ["x >= 2"]\n', "", "unsafe: is missing"),
        (DECAY, '["x >= 2"]', '["x == 2"]', "unsafe.0 = 'x == 2': needs one <= or >="),
        (DECAY, '["x >= 2"]', '["x >= 2*k"]', "unsafe: uses the parameter k"),
        (DECAY, 'multiplier = "-1"', "level = 1.0", "level: belongs to kind lyapunov"),
    ],
)  # fmt: skip
def test_a_mistake_in_the_file_is_named(tmp_path: Path, text: str, old: str, new: str, says: str) -> None:
    path = written(tmp_path, text, (old, new))
    with pytest.raises(InputError) as mistake:
        load_problem(path)
    assert says in str(mistake.value)
    assert str(mistake.value).startswith(str(path))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('rate = "-y"', 'rate = "0.1 - y"', "is not 0 at the equilibrium"),
        ('rate = "-y"', 'rate = "select(y, 0, 1, -1)*y^2"', "van-der-pol.x: contains select"),
        ('y^2"\nlevel', 'y^2 + 0.1"\nlevel', "is not 0 at the equilibrium"),
        ('"1.5*x^2 - x*y + y^2"', '"abs(x) + y^2"', "abs has no derivative everywhere"),
    ],
)
def test_a_claim_that_cannot_be_checked_is_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        solve(load_problem(written(tmp_path, VAN_DER_POL, (old, new))))


def test_definitions_and_constants_are_exact(tmp_path: Path) -> None:
    problem = load_problem(written(tmp_path, VAN_DER_POL, ("mu = 1.0", "mu = 0.1")))
    assert problem.claim is not None
    assert problem.claim.plain()["dynamics"] == {"x": "-y", "y": "x - 0.1*(1 - x^2)*y"}


def test_dynamics_that_are_undefined_at_a_point_of_interest_are_told_so(tmp_path: Path) -> None:
    text = (
        'kind = "lyapunov"\nname = "scalar"\nfunction = "x^2"\nlevel = 0.1\n[states]\n'
        'x = { rate = "-RATE", lower = -1, upper = 1 }\n[parameters]\nm = { lower = 0, upper = 1 }\n'
    )
    for rate, function in (("x/m", True), ("x/m", False), ("x*log(x)", True)):
        whole = text.replace("RATE", rate)
        problem = load_problem(
            written(tmp_path, whole if function else whole.replace('function = "x^2"\nlevel = 0.1', ""))
        )
        with pytest.raises(InputError, match=r"scalar.dynamics: is not finite at x = 0, m = 0"):
            solve(problem)
    # only a corner of the box is outside the domain
    corner = load_problem(written(tmp_path, text.replace("RATE", "log(1 + x) - 0*m")))
    assert solve(corner, time_limit=0.5).verdict != "refuted"  # the claim holds; its proof depends on the time

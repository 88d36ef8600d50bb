"""What every command prints."""

import json
import math

from surctl.cli.output import finite


def test_json_holds_numbers_that_are_finite_alone() -> None:
    told = {"a": math.inf, "b": [math.nan, 1.5, ("x", -math.inf)], 3: {"c": 0, "d": None}}
    assert finite(told) == {"a": None, "b": [None, 1.5, ["x", None]], "3": {"c": 0, "d": None}}
    assert json.loads(json.dumps(finite(told), allow_nan=False)) == finite(told)

"""The verdict is the worst line, and a comparison names what got worse first."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from surctl.assessment import Assessment, Comparison, Figure, Line, Part, assess, loop_line

LINES = st.lists(st.tuples(st.sampled_from([True, False, None]), st.booleans()), max_size=6)


class Drawn:
    """A subject with one part, which has these lines and figures."""

    name = "drawn"

    def __init__(self, lines: tuple[Line, ...] = (), figures: tuple[Figure, ...] = ()) -> None:
        self.part = Part(figures, lines)

    def parts(self):
        return {"main": lambda: self.part, "dear": lambda: 1 / 0}


def assessed(*figures: Figure, lines: tuple[Line, ...] = ()) -> Assessment:
    return assess(Drawn(lines, figures), parts=["main"])


@given(LINES)
def test_the_verdict_is_that_of_the_worst_line_that_counts(drawn) -> None:
    lines = tuple(Line(passed, f"line {k}", counts=counts) for k, (passed, counts) in enumerate(drawn))
    result = assessed(lines=lines)
    counted = [line.passed for line in lines if line.counts]
    worst = False if False in counted else None if None in counted or not counted else True
    assert result.passed is worst
    assert [line.rank for line in result.lines] == sorted(line.rank for line in result.lines)
    assert bool(result.failures) is (worst is False)
    if worst is not True and counted:
        assert result.weakest(1)[0].text in result.banner and result.weakest(1)[0].passed is worst
    # a line that a page adds counts as those of the parts
    assert result.with_lines([Line(False, "late")]).passed is False
    assert result.omitted == ("dear",) and "dear: not assessed" in [line.text for line in result.lines]


VALUES = st.one_of(st.floats(-10, 10), st.just(float("nan")))


@given(VALUES, VALUES, st.sampled_from(["high", "low"]))
def test_a_figure_is_worse_exactly_if_it_moved_the_wrong_way(before, after, better) -> None:
    old = Figure("f", before, "1", "a figure", better)
    new = replace(old, value=after)
    if np.isnan(before):
        assert not new.worse(old)
    elif np.isnan(after):
        assert new.worse(old)
    else:
        lost = after - before if better == "low" else before - after
        assert new.worse(old) is (lost > 1e-9 + 1e-6 * abs(before))
        assert not (new.worse(old) and old.worse(new))


def test_what_got_worse_comes_first_and_names_its_sizes() -> None:
    disk = Figure("disk_margin", 0.4, "1", "margin", "high", 0.3)
    region, time = Figure("region_m", 0.26, "m", "region", "high"), Figure("time_ratio", 1.4, "1", "time", "low")
    after = (replace(disk, value=0.38), replace(region, value=0.0), replace(time, value=1.2))
    told = Comparison(assessed(disk, region, time), assessed(*after))
    assert told.headline == "WORSE than before: region_m 0.26 -> 0, disk_margin 0.4 -> 0.38"
    assert told.lines()[0] == told.headline and told.lines()[3].startswith("region_m")
    assert told.gained == ["time_ratio 1.4 -> 1.2"]
    assert told.lines()[1] == "better than before: time_ratio 1.4 -> 1.2"
    assert told.to_dict()["worse"] == ["region_m", "disk_margin"]
    cost = Figure("cost.error", 0.9, "rad", "what the tuning minimises", "low")
    tuned = Comparison(assessed(time, cost), assessed(after[2], replace(cost, value=0.85)))
    assert tuned.gained == ["cost.error 0.9 -> 0.85", "time_ratio 1.4 -> 1.2"], "a cost first, however little it gained"
    same = Comparison(assessed(disk), assessed(disk))
    assert same.headline == "no figure of the assessment is worse than before"
    gone = Comparison(assessed(disk, region), assessed(disk))
    assert [new.name for _, new in gone.worse] == ["region_m"]  # a figure that is lost is worse


def test_the_line_of_margins_says_what_fails_and_of_which_system() -> None:
    def line(disk: float, delay: float) -> str:
        figures = (
            Figure("disk_margin", disk, "1", "all loops", "high", 0.3, "mass -5%"),
            Figure("nominal_disk_margin", 0.5, "1", "nominal", "high"),
            Figure("delay_margin_s", delay, "s", "least delay margin", "high", 0.2, "yaw at drag +20%"),
            Figure("nominal_delay_margin_s", 0.28, "s", "nominal", "high", where="yaw"),
        )
        return loop_line({f.name: f for f in figures}, stable=True, place="at rest", unstable="").text

    delay = "least delay margin 0.25 s at the worst corner, 0.28 s nominal (yaw)"
    assert line(0.3, 0.25) == f"margins at rest: disk margin 0.30 at the worst corner, 0.50 nominal; {delay}"
    assert "disk margin 0.2988 at" in line(0.29882, 0.25) and "; too small: a disk margin of 0.2988 at mass" in line(
        0.29882, 0.25
    )
    assert line(0.29, 0.1).count("disk margin 0.29 at") == 1
    short = "a delay margin of 0.1998 s in yaw at drag +20% (at least 0.2 s)"
    assert line(0.4, 0.19984).endswith(f"; too small: {short}")
    assert "least delay margin 0.1998 s at" in line(0.4, 0.19984)

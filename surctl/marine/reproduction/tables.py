"""Compare the paper's tables: the quantities of Table I that the model contains, and the 36 percentages of Table II."""

from __future__ import annotations

from functools import partial

from surctl.marine.reproduction.row import Item, Result, Word, agrees, differs, wrong_in_print
from surctl.marine.reproduction.scenarios import ABOUT
from surctl.marine.sensing import SonarArray
from surctl.marine.sensing.calibration.table2 import MEDIA, Medium, table_ii

__all__ = ["table_items"]


def table_items() -> list[Item]:
    """Return the comparisons for Table I (range and resolution) and for Table II.

    No model uses the other quantities of Table I: size, supply and frequency.
    """
    items = [
        Item(
            f"table-i-{name}",
            "tables",
            what,
            f"Table I: {paper}",
            word,
            partial(_sensor, name),
            _own(f"table-i-{name}"),
        )
        for name, what, paper, word in _SENSOR
    ]
    test = table_ii()
    for medium in MEDIA:
        for k, desired in enumerate(test.desired):
            name = f"table-ii-{medium}-{round(100 * desired):03d}"
            printed, wrong = float(test.column(medium).printed_percent[k]), (medium, round(100 * desired)) == _E2
            items.append(
                Item(
                    name,
                    "tables",
                    f"error at {100 * desired:.0f} cm in {medium}",
                    f"Table II: {printed:.1f} %",
                    "wrong in print" if wrong else "agrees",
                    partial(_percentage, medium, k),
                    _own(name),
                )
            )
    return items


_SENSOR: tuple[tuple[str, str, str, Word], ...] = (
    ("minimum", "minimum range of the sensor", "0.2 m", "agrees"),
    ("maximum", "maximum range of the sensor", "4.5 m", "agrees"),
    ("resolution", "resolution of the sensor", "about 5 mm", "differs"),
)
_E2 = ("water", 85)  # the row whose percentage is printed wrongly
_PRINTED = {"minimum": 0.2, "maximum": 4.5, "resolution": 0.005}  # [m]


def _own(name: str) -> str:
    return f"surctl reproduce {name}"


def _sensor(name: str) -> Result:
    # Table I, compared with the default sonar array
    ours, printed = float(getattr(SonarArray(), "blind" if name == "minimum" else name)), _PRINTED[name]
    text = f"{ours:.4g} m" if name != "resolution" else f"{1e3 * ours:.2f} mm"
    # a step finer than "about 5 mm" also agrees
    if ours <= (1 + ABOUT) * printed if name == "resolution" else abs(ours - printed) <= 1e-9:
        return agrees(text, metres=ours)
    why = f"section II-B gives a conversion with {SonarArray().bits} bits over {SonarArray().maximum:g} m"
    return differs(text, why, metres=ours)


def _percentage(medium: Medium, k: int) -> Result:
    # agrees if the recomputed percentage rounds to the printed decimal
    test = table_ii()
    ours, column = float(test.percent(medium)[k]), test.column(medium)
    printed = float(column.printed_percent[k])
    text = f"{ours:.3f} %"
    if k not in test.disagreeing(medium):
        return agrees(text, percent=ours)
    read, true = 100 * column.measured[k], 100 * test.desired[k]
    return wrong_in_print(
        text,
        f"a reading of {read:.0f} cm at {true:.0f} cm is an error of {ours:.1f} %, not {printed:.1f} %",
        percent=ours,
    )

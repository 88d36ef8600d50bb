"""The law with other depths: what it is told and tells, what it forgets, and what the others make of the option."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.ir import memory, replay
from surctl.marine.control import Law, build_law, load_gains
from surctl.marine.control.dead_end import LAYER_PORTS
from surctl.marine.control.ports import law_parameters
from surctl.marine.guidance import Path
from surctl.marine.sensing import Equipment
from surctl.marine.vehicle import load_vehicle

Array = NDArray[np.float64]
VEHICLE, GAINS = load_vehicle("sur540-flooded"), load_gains("default")
TRUTH = Equipment(own=None)  # it is told its pose


@cache
def _law(*, sonar: bool, depths: bool = True) -> Law:
    return build_law(sonar=sonar, depths=depths, equipment=TRUTH)


@cache
def _parameters() -> Array:
    path = Path(np.array([[0.5, 2.5], [9.5, 2.5]]))
    return law_parameters(
        GAINS, VEHICLE, path=path, depth=-2.0, cruise=0.2, cap=0.22, walls=(0.0, 10.0, 0.0, 5.0), launch=0.5
    )


def _step(law: Law, x: Array, *, z: float, column: tuple[float, float] = (1.5, 1.5), speed: float = 0.0) -> list[Array]:
    """(tau, next state, status, telemetry) of one step at (4, 2.5), replayed."""
    u = law.inputs.pack({"eta": [4.0, 2.5, z, 0.0], "nu": [speed, 0.0, 0.0, 0.0], "column": column})
    return [np.asarray(part, dtype=float).ravel() for part in replay(law.block, x, u, _parameters())]


def test_only_the_guarded_law_takes_it_and_without_it_nothing_changes() -> None:
    assert "column" not in build_law("paper", depths=True).inputs
    plain, deep = _law(sonar=False, depths=False), _law(sonar=False)
    assert [p for p in deep.state if p not in plain.state.ports] == list(LAYER_PORTS)
    assert {p.name for p in deep.inputs} - {p.name for p in plain.inputs} == {"column"}
    assert {p.name for p in deep.outputs} - {p.name for p in plain.outputs} == {"depth_reference"}
    assert deep.gains.ports == plain.gains.ports
    assert plain.block.digest() == build_law().block.digest()


def test_it_costs_next_to_nothing() -> None:
    plain, deep = _law(sonar=False, depths=False), _law(sonar=False)
    assert deep.state.size == plain.state.size + 3 and deep.inputs.size == plain.inputs.size + 2
    assert memory(deep.block) - memory(plain.block) < 100


@pytest.mark.parametrize(("changing", "forgets"), [(-1.0, True)])
def test_the_map_is_forgotten_once_another_depth_is_reached(changing: float, forgets: bool) -> None:
    law = _law(sonar=True)
    x = law.state.pack(
        {"progress": 3.5, "searched": (4.0, 4.0, 2.5, 2.5), "furthest": 3.5, "layer": 1.0, "beyond": 9.0}
    )
    x = _step(law, x, z=-1.41)[1]  # the window lies around the robot
    x[law.state.slice("map_cells")], x[law.state.slice("changing")] = 0.8, changing
    after = _step(law, x, z=-1.7)[1]
    assert np.mean(after[law.state.slice("map_cells")] > 0.5) == pytest.approx(0.0 if forgets else 1.0, abs=0.05)
    assert after[law.state.slice("changing")] == max(changing, 0.0)
    told = law.decision_inputs(x, law.inputs.pack({"eta": [4.0, 2.5, -1.7, 0.0], "column": (1.5, 1.5)}), _parameters())
    marked = told[law.perception.outputs.slice("contacts")].reshape(-1, 6)[8:, 5]  # type: ignore[union-attr]
    assert np.any(marked > 0.5) != forgets


@pytest.mark.parametrize(
    ("column", "speed", "wanted"),
    [((1.5, 1.5), 0.0, 0.1), ((0.05, 1.5), 0.0, 0.0), ((0.06, 0.0), 0.0, 0.0144), ((1.5, 1.5), 0.1, 0.0)],
)
def test_it_rises_no_faster_than_it_can_stop_in_the_water_that_is_free(
    column: tuple[float, float], speed: float, wanted: float
) -> None:
    law = _law(sonar=False)
    x = law.state.pack({"layer": 1.0, "changing": 1.0, "searched": (4.0, 4.0, 2.5, 2.5), "furthest": 3.5})
    telemetry = _step(law, x, z=-2.0, column=column, speed=speed)[3]
    asked = telemetry[law.telemetry_slice("nu_reference")]
    assert asked[2] == pytest.approx(wanted, abs=1e-4)
    assert telemetry[law.telemetry_slice("depth_reference")] == pytest.approx(-1.41)
    assert telemetry[law.telemetry_slice("avoiding")] == 1.0


def test_it_stops_within_the_free_water_by_the_least_thrust_it_counts_on() -> None:
    """s²/(2a) + s t ≤ free − margin, for any free water."""
    law, a = _law(sonar=False), GAINS["brake"] * VEHICLE["Fw_max"] / VEHICLE["m33"]
    x = law.state.pack({"layer": 1.0, "changing": 1.0, "searched": (4.0, 4.0, 2.5, 2.5), "furthest": 3.5})
    for free in np.linspace(0.05, 0.3, 12).tolist():
        telemetry = _step(law, x, z=-2.0, column=(free, 0.0))[3]
        s = float(telemetry[law.telemetry_slice("nu_reference")][2])
        assert 0 <= s <= 0.1 + 1e-12
        assert s * s / (2 * a) + s * GAINS["reaction"] <= free - GAINS["margin"] + 1e-9

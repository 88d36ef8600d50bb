"""What a hull meets beside, above and below it: by hand, by brute force, and alike in both loops."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from surctl.marine.simulation import Body
from surctl.marine.simulation.batch.structure import Body as Symbols
from surctl.marine.simulation.scenario import load_scenario
from surctl.marine.simulation.world import BAND, FOOTPRINT, LONGEST, beside
from surctl.marine.world import WHOLE, Box, Disc, Heights, Prism
from tests.oracles.mission_loop import column

HULL = 0.27
TANK = replace(load_scenario("tank-static"), depths=(-4.0, -0.5))


def _body(shape: Box | Disc, heights: Heights) -> Body:
    return Body("it", shape, np.zeros(2), moving=False, heights=heights)


def _drawn(rng: np.random.Generator) -> Body:
    centre = rng.uniform(-1, 1, 2)
    shape = Disc(centre, rng.uniform(0.1, 0.5)) if rng.random() < 0.5 else Box(centre, rng.uniform(0.1, 1, 2))
    ends = np.sort(rng.uniform(-4, 0, 2))
    every = [Heights(*ends), Heights(top=ends[0]), Heights(bottom=ends[1]), WHOLE]
    return _body(shape, every[rng.integers(4)])


def test_by_hand() -> None:
    sill = _body(Box((0.0, 0.0), (1.0, 1.0)), Heights(top=-1.8))
    roof = _body(Disc((0.0, 0.0), 0.5), Heights(bottom=-1.0))
    over = (0.0, 0.0, -1.41)
    assert column(TANK, [sill], over, HULL) == pytest.approx((-0.5 - HULL + 1.41, 1.8 - 1.41 - HULL))
    assert column(TANK, [sill, roof], over, HULL) == pytest.approx((0.41 - HULL, 1.8 - 1.41 - HULL))
    away = (0.5 + HULL + FOOTPRINT + 1e-6, 0.0, -1.41)
    assert column(TANK, [sill], away, HULL)[1] == pytest.approx(4.0 - 1.41 - HULL)
    near = (0.5 + HULL + FOOTPRINT - 1e-6, 0.0, -1.41)
    assert column(TANK, [sill], near, HULL)[1] == pytest.approx(1.8 - 1.41 - HULL)
    assert column(replace(TANK, depths=None), [], over, HULL) == (0.0, 0.0)
    assert beside([sill], -1.8 + HULL + BAND - 1e-6, HULL) == [sill]
    assert beside([sill], -1.8 + HULL + BAND + 1e-6, HULL) == []


@pytest.mark.parametrize("seed", range(30))
def test_as_far_as_the_column_is_free_a_hull_that_keeps_its_place_touches_nothing(seed: int) -> None:
    """And what is not heard beside it is not touched either, however far it goes at this depth."""
    rng = np.random.default_rng(seed)
    bodies = [_drawn(rng) for _ in range(3)]
    x, y, z = rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(-3.5, -1)
    solids = [Prism(body.shape, body.heights) for body in bodies]
    if min(solid.distance(x, y, z) for solid in solids) > HULL:
        above, below = column(TANK, bodies, (x, y, z), HULL)
        for level in np.linspace(z - below, z + above, 50).tolist():
            if all(body.shape.foot(x, y)[0] > HULL for body in bodies if body.heights.crosses(z, 0.0)):
                assert min(solid.distance(x, y, level) for solid in solids) >= HULL - 1e-9
    for body in bodies:
        if body not in beside(bodies, z, HULL):
            assert all(
                Prism(body.shape, body.heights).distance(*place, z) >= HULL + BAND
                for place in rng.uniform(-2, 2, (20, 2))
            )


def test_a_body_that_is_not_there_is_neither_above_nor_below() -> None:
    gone = Symbols(ca.SX.zeros(2), ca.SX.ones(1), ca.SX.zeros(2), ca.SX(0), moving=False, heights=ca.SX([-5, -2]))
    assert [float(ca.DM(ca.evalf(way))) for way in gone.over_and_under(ca.SX([0, 0, -1]), ca.SX(HULL))] == [LONGEST] * 2

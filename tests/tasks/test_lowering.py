"""Every limit can be generated as C: its rows use only operations of the instruction list."""

from functools import partial

import casadi as ca
import numpy as np
import pytest

from surctl.ir import lower
from surctl.marine.vehicle import PLANT_PARAMETERS, plant_thrust_limit
from surctl.tasks import (
    AccelerationLimit,
    Barrier,
    RateLimit,
    SetTask,
    ThrustLimit,
    VelocityBox,
    allowed_closing_speed,
    position_task,
)

ETA, NU, MASS = ca.SX.sym("eta", 4), ca.SX.sym("nu", 4), ca.SX.sym("M", 4, 4)
FLAT, PARTS = PLANT_PARAMETERS.symbols("p")
DISC = ca.norm_2(ETA[:2]) - 1
STOPPING = partial(allowed_closing_speed, deceleration=0.1, reaction=0.3)
FULL = ThrustLimit(NU, MASS, load=[0] * 4, lower=[-1] * 4, upper=[1] * 4, dt=0.05)
PLAIN = plant_thrust_limit(NU, PARTS, dt=0.05)


@pytest.mark.parametrize(
    "limit",
    [
        VelocityBox([-0.1] * 4, [0.1, 0.1, 0.1, np.inf]),
        PLAIN,
        FULL,
        AccelerationLimit(NU, [0.1] * 4, dt=0.05),
        Barrier("disc", ETA, h=DISC, alpha=lambda s: ca.fmin(s, 1), kinematics="vehicle"),
        Barrier("stop", ETA, h=DISC, alpha=STOPPING, kinematics="vehicle"),
        RateLimit(position_task(ETA, [1, 2]), 0.1),
        SetTask(name="arc", eta=ETA, sigma=ETA[3], lower=-1, upper=1, angular=True, kinematics="vehicle"),
    ],
    ids=lambda limit: type(limit).__name__,
)
def test_rows_are_in_the_instruction_list(limit):
    rows = [ca.horzcat(r.a, r.lower, r.upper) for r in limit.rows()]
    made = lower(ca.Function("rows", [ETA, NU, ca.vec(MASS), FLAT], [ca.densify(ca.vertcat(*rows))]))
    assert 0 < len(made.instructions) < 500

"""Systems that the tests share: a pendulum with saturated state feedback, and a level with integral control."""

from __future__ import annotations

import casadi as ca

from surctl.ir import Layout, Port
from surctl.system import Action, Controller, Cost, Plant, System

ANGLE, RATE = Port("angle", (1,), "rad", "from upright", 0.4), Port("rate", (1,), "rad/s", "angular rate")
TORQUE = Port("torque", (1,), "N m", "at the pivot")
LIMIT = 5.0


def pendulum_plant() -> Plant:
    return Plant(
        "pendulum",
        state=Layout((ANGLE, RATE)),
        inputs=Layout((TORQUE,)),
        parameters=Layout((Port("gravity", (1,), "1/s^2", "g / l", 9.81), Port("drag", (1,), "1/s", "friction", 0.1))),
        disturbances=Layout((Port("gust", (1,), "N m", "of the wind"),)),
        ode=lambda x, f, d, p: {
            "angle": x["rate"],
            "rate": p["gravity"] * ca.sin(x["angle"]) - p["drag"] * x["rate"] + f["torque"] + d["gust"],
        },
    )


def state_feedback() -> Controller:
    def law(x, u, p):
        free = -(p["k_angle"] * u["angle"] + p["k_rate"] * u["rate"])
        torque = ca.fmin(ca.fmax(free, -LIMIT), LIMIT)
        return Action(torque, telemetry={"free": free}, status=ca.fabs(free) > LIMIT)

    return Controller(
        "state_feedback",
        dt=0.01,
        inputs=Layout((ANGLE, RATE)),
        command=Layout((TORQUE,)),
        gains=Layout((Port("k_angle", (1,), "N m/rad", "", 19.7), Port("k_rate", (1,), "N m s/rad", "", 6.2))),
        telemetry=Layout((Port("free", (1,), "N m", "torque before the limit"),)),
        law=law,
    )


COSTS = {
    "energy": Cost(lambda s: s.f["torque"] ** 2, "integral", "N^2 m^2 s"),
    "mean_angle": Cost(lambda s: s.x["angle"], "mean", "rad"),
    "rms_torque": Cost(lambda s: s.f["torque"], "rms", "N m"),
    "most": Cost(lambda s: ca.fabs(s.k["free"]), "max", "N m"),
    "least": Cost(lambda s: s.x["angle"], "min", "rad"),
    "end": Cost(lambda s: s.x["angle"] + s.t, "final", "rad"),
    "settling": Cost(lambda s: ca.fabs(s.x["angle"]) - 0.01, "last_time", "s"),
}


def pendulum() -> System:
    return System(
        pendulum_plant(), state_feedback(), costs=COSTS, stops={"fallen": lambda s: ca.fabs(s.x["angle"]) > 1.5}
    )


def level() -> System:
    """A tank with drain, proportional-integral control of its level, and an inflow that nobody measures."""
    height, target = Port("height", (1,), "m", "of the water"), Port("target", (1,), "m", "desired height", 1.0)
    flow = Port("flow", (1,), "m/s", "controlled inflow over the area")
    plant = Plant(
        "tank",
        state=Layout((height,)),
        inputs=Layout((flow,)),
        disturbances=Layout((Port("rain", (1,), "m/s", "inflow"),)),
        ode=lambda x, f, d, p: {"height": f["flow"] + d["rain"] - 0.2 * x["height"]},
    )
    law = Controller(
        "level_control",
        dt=0.1,
        inputs=Layout((height, target)),
        command=Layout((flow,)),
        state=Layout((Port("sum", (1,), "m s", "integral of the error"),)),
        gains=Layout((Port("k_p", (1,), "1/s", "", 0.8), Port("k_i", (1,), "1/s^2", "", 0.3))),
        law=lambda x, u, p: Action(
            p["k_p"] * (u["target"] - u["height"]) + p["k_i"] * x["sum"],
            {"sum": x["sum"] + 0.1 * (u["target"] - u["height"])},
        ),
    )
    return System(plant, law, costs={"error": Cost(lambda s: s.r["target"] - s.x["height"], "final", "m")})

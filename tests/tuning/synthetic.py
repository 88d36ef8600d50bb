"""A closed loop that costs nothing: smooth figures of two gains, one plant parameter and the seed."""

from dataclasses import replace

import numpy as np

from surctl.marine.control import load_gains
from surctl.marine.simulation import METRICS, BatchResult, Case, load_scenario
from surctl.marine.tuning import Goal, Request, conditions, gain_ranges
from surctl.marine.vehicle import load_vehicle

GAINS = load_gains("default")

CLEAR = Goal("keep clear", "min_clearance_m", "m", 0.05, "at least", "hard")
NEAR = Goal("stay near", "deviation_m", "m", 0.30)
THRIFT = Goal("spare thrust", "effort_n", "N", 3.0, over="mean")
MARGIN = Goal("delay margin", "delay_margin_s", "s", 0.2, "at least", "hard")


def case(name="pool-static", vehicle="sur400"):
    return Case(load_scenario(name), load_vehicle(vehicle), GAINS)


def request(goals=(CLEAR, NEAR, THRIFT), *, seed=0, seeds=range(2), with_corners=False, **given):
    given = given or {"k_v": (0.5, 4.0), "k1": (0.1, 1.2)}
    flown = conditions([case()], seeds=seeds, with_corners=with_corners)
    return Request(tuple(goals), flown, GAINS, gain_ranges(GAINS, given), seed=seed)


def heavy(goals=None):
    """A request for `Loop(mass=...)`, whose clearance shrinks with a mass that is off: the vehicle states a range."""
    asked = request(goals or (CLEAR, replace(NEAR, limit=0.45), THRIFT))
    tank = case("tank-static", "sur540-flooded")
    return replace(asked, conditions=tuple(replace(c, case=tank) for c in asked.conditions[:1]))


class Loop:
    """Counts the runs; `clearance` shrinks with speed, with mass and with an unlucky seed."""

    def __init__(self, mass=0.0):
        self.runs, self.calls, self.mass = 0, 0, mass

    def __call__(self, case, values=None, *, seeds=0, threads=1):
        values = values or {}
        arrays = np.broadcast_arrays(np.asarray(seeds), *values.values())
        v = dict(zip(values, arrays[1:], strict=True))
        seed = arrays[0].astype(float)
        k_v, k1 = v.get("k_v", GAINS["k_v"]), v.get("k1", GAINS["k1"])
        heavy = v.get("plant.m11", case.vehicle["m11"]) / case.vehicle["m11"] - 1
        luck = 0.004 * np.sin(seed)
        clear = 0.09 - 0.05 * k1 + 0.01 * np.log(k_v) + luck - self.mass * np.abs(heavy)
        found = dict.fromkeys(METRICS, np.zeros(seed.shape))
        found["reached"] = np.where(k1 > 0.12, 1.0, 0.0) + 0 * seed
        found["stopped"] = found["reached"]  # index in STOPS: 1 is "reached", 0 the time limit
        found["min_clearance_m"] = clear
        found["deviation_m"] = 0.1 + 0.05 / k1 + 0.05 * np.abs(np.log(k_v / 2)) + luck
        found["effort_n"] = 1.0 + 0.6 * k_v + 0.5 * k1 + 0 * seed
        found["time_s"] = 20 / (0.5 + k1) + 0 * seed
        table = np.column_stack([np.broadcast_to(found[name], seed.shape).ravel() for name in METRICS])
        table = np.round(table, 9)  # numpy's sine and logarithm differ in the last digit with an array's alignment
        self.runs, self.calls = self.runs + seed.size, self.calls + 1
        return BatchResult(table, "c")


def linear(vehicle, values, *, base, cruise, dt, model=None, **_):
    count = len(next(iter(values.values())))
    k_v = np.broadcast_to(np.asarray(values.get("k_v", base["k_v"]), dtype=float), (count,))
    light = np.broadcast_to(np.asarray(values.get("plant.m11", vehicle["m11"]), dtype=float), (count,))
    return {"delay_margin_s": 0.6 / k_v * light / vehicle["m11"]}


def install(monkeypatch, loop=None):
    from surctl.marine.tuning import evaluation, request

    loop = loop or Loop()
    monkeypatch.setattr(evaluation, "simulate_batch", loop)
    monkeypatch.setattr(request, "simulate_batch", loop)
    monkeypatch.setattr(evaluation, "linear_table", linear)
    monkeypatch.setattr(Request, "first_sets", lambda *_, **__: [])
    monkeypatch.setattr(Request, "refuted_claims", lambda *_, **__: ())
    return loop

"""A batch that costs nothing: smooth figures of the knobs, behind the interfaces of the real ones."""

from __future__ import annotations

from importlib import import_module
from types import SimpleNamespace

import numpy as np

from surctl.marine.control import load_gains
from surctl.marine.simulation import METRICS, Case, load_scenario
from surctl.marine.vehicle import load_vehicle

GAINS = load_gains("default")
SWEEP = import_module("surctl.marine.tuning.sweep")


def case(name="pool-behind", sensing="truth"):
    scenario = load_scenario(name)
    return Case(scenario, load_vehicle(scenario.vehicle), GAINS, sensing=sensing)


class Batch:
    def __init__(self, columns):
        self.columns = columns

    def column(self, name):
        return self.columns[name]


def figures(k_v, lookahead, m11, seed, shift):
    """Metrics by closed form; `path_error_m` lacks where the seed is odd."""
    base = (k_v - 2.0) ** 2 + 0.3 * (lookahead - 0.8) ** 2 + 0.001 * m11 + 0.01 * seed + shift
    found = {name: base + k for k, name in enumerate(METRICS)}
    found |= {"reached": (k_v > 0.6).astype(float), "collided": np.zeros_like(base)}
    return found | {"path_error_m": np.where(seed % 2 == 1, np.nan, base), "min_clearance_m": 0.05 - 0.01 * seed}


def fly(case, values, *, seeds):
    n = len(seeds)
    knob = {name: np.broadcast_to(values.get(name, d), n) for name, d in (("k_v", 1.5), ("lookahead", 0.8))}
    m11 = np.broadcast_to(values.get("vehicle.m11", 50.0), n)
    return Batch(figures(knob["k_v"], knob["lookahead"], m11, seeds.astype(float), len(case.scenario.name) / 100))


CALLS = []


def linear(vehicle, values, *, base, cruise, dt, model=None, law=None):
    n = len(next(iter(values.values())))
    CALLS.append(n)
    k_v = np.broadcast_to(values.get("k_v", base["k_v"]), n)
    return {name: 1.0 / k_v + k for k, name in enumerate(SWEEP.LINEAR_METRICS)}


def install(monkeypatch):
    monkeypatch.setattr(SWEEP, "simulate_batch", fly)
    monkeypatch.setattr(SWEEP, "linear_table", linear)
    monkeypatch.setattr(SWEEP, "law_digest", lambda case: "stub")
    monkeypatch.setattr(SWEEP, "build_law", lambda law: SimpleNamespace(dt=0.05))
    CALLS.clear()

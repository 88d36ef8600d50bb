"""Points of a claim at which a changed law is compared with the exported one, in surctl's own replay of its list."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from pairs import Pair

COUNT = 60


def vectors(pair: Pair, file: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return state, inputs and gains (COUNT, n) of the law, near what the certificate is about."""
    rng, manifest = np.random.default_rng(3), json.loads(pair.bundle.files["manifest.json"])
    entry, claim = manifest["lists"][file], pair.certificate["claim"]
    gains = {row["name"]: np.array(row["values"]) for row in manifest["gains"]["values"]}
    if claim.get("about"):
        sizes = [sum(int(row.split("[")[1].split("]")[0]) for row in entry[key]) for key in ("state", "inputs")]
        x, u = (rng.uniform(-0.5, 0.5, (COUNT, size)) for size in sizes)
        return x, u, np.tile(np.concatenate([*gains.values()]), (COUNT, 1))
    braking = pair.certificate["kind"] == "braking"
    scale = 50.0 * gains["lookahead"][0]
    low, high = gains["cruise"][0] * np.array([0.5, 1.0])
    speed = rng.uniform(low, high, COUNT)
    y = 0.0 if braking else 0.3 * gains["lookahead"][0] * rng.uniform(-1, 1, COUNT)
    psi = rng.uniform(-0.3, 0.3, COUNT) + rng.uniform(-3, 3, COUNT)
    ahead = scale + (-0.5 if braking else 0.1 * rng.uniform(-1, 1, COUNT))
    c, s = np.cos(psi), np.sin(psi)
    parts = {
        "progress": np.full(COUNT, scale), "surge": speed,
        "eta": np.stack([np.full(COUNT, 1.0) * ahead, np.full(COUNT, 1.0) * y, np.full(COUNT, -3.0), psi], 1),
        "nu": np.stack([c * speed, -s * speed, 0 * c, 0 * c], 1),
        "waypoints": np.tile([0.0, 0.0, *[4 * scale, 0.0] * (gains["waypoints"].size // 2 - 1)], (COUNT, 1)),
        "walls": np.tile([-1e5, 1e5, -1e5, 1e5], (COUNT, 1)), "depth": np.full((COUNT, 1), -3.0),
        "visit": np.zeros((COUNT, 1)),
    }  # fmt: skip
    if braking:
        clearance = rng.uniform(gains["margin"][0], 1.0, COUNT)
        disc = np.stack([ahead + clearance + gains["hull"][0] + 1.0, 0 * c, 0 * c + 1.0, 0 * c, 0 * c, 0 * c + 1], 1)
        parts["contacts"] = np.hstack([disc, np.zeros((COUNT, 42))])
    numbers = {"state": start(entry), "inputs": {}, "gains": gains}
    rows = []
    for key in ("state", "inputs", "gains"):
        blocks = []
        for row in entry[key]:
            name, size = row.split("[")[0], int(row.split("[")[1].split("]")[0])
            value = parts.get(name, numbers[key].get(name, np.zeros(size)))
            blocks.append(np.broadcast_to(np.reshape(value, (-1, size)), (COUNT, size)))
        rows.append(np.hstack(blocks))
    return rows[0], rows[1], rows[2]


def start(entry: dict[str, Any]) -> dict[str, np.ndarray]:
    """Return the initial state of a list by the names of its parts."""
    sizes = {row.split("[")[0]: int(row.split("[")[1].split("]")[0]) for row in entry["state"]}
    return {name: np.broadcast_to(np.array(v, dtype=float), (size,))
            for (name, size), v in zip(sizes.items(), entry["initial_state"], strict=True)}  # fmt: skip

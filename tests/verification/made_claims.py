"""Claims with a known answer: functions whose largest value is known, against a bound above or below it."""

from fractions import Fraction

import casadi as ca
import numpy as np

from surctl.verification import Claim, Variable
from surctl.verification.formula import parse, to_casadi, variable

GAPS = (1e-6, 1e-4, 1e-2, 0.3)


def claim_from(name, box, left, right, constraints=(), expected="proved") -> Claim:
    symbols = {n: ca.SX.sym(n) for n in box}
    known = {n: variable(n) for n in box}
    rows = [to_casadi(parse(g, known), symbols) for g in constraints]
    return Claim(
        name, f"{left} <= {right}", "", (), expected,
        tuple(Variable(n, symbols[n], "1", lo, hi, "") for n, (lo, hi) in box.items()),
        to_casadi(parse(left, known), symbols), to_casadi(parse(right, known), symbols), "1",
        ca.vertcat(ca.SX(0, 1), *rows),
    )  # fmt: skip


def text(x: float) -> str:
    return f"({float(x)!r})"


def _hill(rng):
    """A concave quadratic with its top inside, at decimals: the top value is exact."""
    n = int(rng.integers(1, 4))
    names = "xyz"[:n]
    top = [Fraction(int(rng.integers(-80, 81)), 100) for _ in names]
    weights = [float(np.round(rng.uniform(0.3, 3), 2)) for _ in names]
    parts = [f"{w!r}*({v} - ({float(t)!r}))^2" for v, w, t in zip(names, weights, top, strict=True)]
    height = float(np.round(rng.uniform(-1, 1), 2))
    return dict.fromkeys(names, (-1.0, 1.0)), f"{text(height)} - " + " - ".join(parts), text(height), ()


def _waves(rng):
    a, b, p = (float(np.round(rng.uniform(0.2, 2), 2)) for _ in range(3))
    k = int(rng.integers(1, 4))
    return {"x": (-4.0, 4.0), "y": (-4.0, 4.0)}, f"{a!r}*sin({k}*x + {p!r}) + {b!r}*cos(y)", f"{a!r} + {b!r}", ()


def _bell(rng):
    a, p = (float(np.round(rng.uniform(0.2, 0.9), 2)) for _ in range(2))
    return {"x": (-2.0, 2.0), "y": (-2.0, 2.0)}, f"{a!r}/(1 + (x - {p!r})^2 + y^2)", f"{a!r}", ()


def _disk(rng):
    r = float(np.round(rng.uniform(0.3, 1.4), 2))
    return {"x": (-2.0, 2.0), "y": (-2.0, 2.0)}, "x + y", f"{r!r}*sqrt(2)", (f"x^2 + y^2 - {r!r}^2",)


def _roof(rng):
    p = float(np.round(rng.uniform(-0.9, 0.9), 2))
    return {"x": (-1.0, 1.0), "y": (-1.0, 1.0)}, f"max(y, -y) - abs(x - {text(p)}) + min(x, 2)*0", "1", ()


def _corner(rng):
    a, b = (float(np.round(rng.uniform(0.5, 2), 2)) for _ in range(2))
    return (
        {"x": (0.1, a), "y": (0.2, b)},
        "sqrt(x^2 + y^2)*x - acos(y/4)/10",
        (f"sqrt({a!r}^2 + {b!r}^2)*{a!r} - acos({b!r}/4)/10"),
        (),
    )


def _saddle(rng):
    """x y on a slanted strip: the top lies where two constraints meet the box."""
    c = float(np.round(rng.uniform(0.2, 0.9), 2))
    return {"x": (0.0, 2.0), "y": (0.0, 2.0)}, "x*y", f"{c!r}^2/4", (f"x + y - {c!r}",)


def _angle(rng):
    a = float(np.round(rng.uniform(0.2, 1.5), 2))
    return {"x": (0.5, 2.0), "y": (-a, a)}, "atan2(y, x) + atan(y)", f"atan({a!r}/0.5) + atan({a!r})", ()


FAMILIES = (_hill, _waves, _bell, _disk, _roof, _corner, _saddle, _angle)


def made(seed: int, *, true: bool) -> tuple[Claim, float]:
    """A claim and by how much its bound lies above (true) or below (false) the largest value."""
    rng = np.random.default_rng(seed)
    family = FAMILIES[seed % len(FAMILIES)]
    gap = float(rng.choice(GAPS))
    box, left, top, constraints = family(rng)
    right = f"{top} {'+' if true else '-'} {gap!r}"
    return claim_from(f"{family.__name__[1:]}-{seed}", box, left, right, constraints), gap

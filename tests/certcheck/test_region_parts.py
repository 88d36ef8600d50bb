"""Certificates of cruises that lack one part of their proof, and bounds of a shell that hold at drawn vehicles."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from itertools import islice
from math import isqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpmath import mp

from surctl.certcheck import check_document, region, region_inclusion, region_trim
from surctl.certcheck.document import Rejected
from surctl.certcheck.region_claim import CruiseClaim, read_claim
from surctl.certcheck.region_exact import Matrix, inverse, quadratic, scaled
from surctl.certcheck.region_inclusion import Vertex, _commanded, _thrust_share, rate_matrix, shell, vertices
from surctl.certcheck.region_trim import Trim, steady_trim
from surctl.certcheck.turning import require_bound, require_starts
from tests.certcheck.altering import sealed
from tests.certcheck.cruise_inclusion import check_identity

HERE = Path(__file__).parent


def document(name: str) -> dict[str, Any]:
    return json.loads((HERE / f"region-cruise-{name}.json").read_text())


def reason(changed: dict[str, Any]) -> str:
    return check_document(sealed(changed)).reason


def parts(name: str = "20-norms-force", **changes: Any) -> tuple[CruiseClaim, Matrix, Trim]:
    whole = document(name)
    for key, value in changes.items():
        next(part for part in whole["claim"].values() if isinstance(part, dict) and key in part)[key] = value
    claim, lower = read_claim(whole["claim"]), whole["proof"]["P"]
    p = [[Fraction(repr(lower[max(i, j)][min(i, j)])) for j in range(len(lower))] for i in range(len(lower))]
    return claim, p, steady_trim(claim)


@pytest.mark.parametrize("name", ["20-norms-force", "20-lag"])
def test_the_region_is_the_last_shell(name: str) -> None:
    whole = document(name)
    for shells in (
        whole["proof"]["shells"][:-1],
        [*whole["proof"]["shells"], {**whole["proof"]["shells"][-1], "level": 1.5}],
    ):
        changed = copy.deepcopy(whole)
        changed["proof"]["shells"] = shells
        assert "must end at level 1" in reason(changed)


@pytest.mark.parametrize(
    ("where", "wrong", "says"),
    [
        ("P", lambda p: p[:-1], "lower triangle"),
        ("P", lambda p: [*p[:-1], p[-1][:-1]], "lower triangle"),
        ("P", lambda p: [p[0], *p[1:-1], 7], "lower triangle"),
        ("P", lambda p: [7, *p[1:]], "lower triangle"),
        ("P", lambda p: {}, "lower triangle"),
        ("P", lambda p: [[-p[0][0]], *p[1:]], "not positive definite"),
        ("shells", lambda s: [], "1 to 40 shells"),
        ("shells", lambda s: s * 40, "1 to 40 shells"),
        ("shells", lambda s: {"a": s[0]}, "1 to 40 shells"),
        ("shells", lambda s: [{**s[0], "multipliers": s[0]["multipliers"][:-1]}, *s[1:]], "must have 5 multipliers"),
        ("shells", lambda s: [{**s[0], "multipliers": dict.fromkeys("abcde")}, *s[1:]], "must have 5 multipliers"),
        ("shells", lambda s: s[::-1], "the level of a shell must be above"),
        ("floor", lambda f: 0.0, "proof.floor must be above 0"),
    ],
)
def test_a_malformed_proof_is_named(where: str, wrong: Callable[[Any], Any], says: str) -> None:
    changed = document("20-norms-force")
    changed["proof"][where] = wrong(changed["proof"][where])
    assert says in reason(changed)


@pytest.mark.parametrize("at", [0, 5])
def test_every_shell_needs_its_decay(at: int) -> None:
    changed = document("20-norms-force")
    changed["proof"]["shells"][at]["multipliers"] = [0.0] * 5
    assert "V does not decay at the claimed rate between levels" in reason(changed)


def test_the_starts_lie_in_the_region_on_both_sides_for_every_offset_along_the_path() -> None:
    claim, p, steady = parts("ranges", offset_m=0.01)
    for along in (0, 1):  # where ω has one sign, only one of the points is outside: the other side is left free
        for side in (1, -1):
            omega = [Fraction(0), Fraction(0)]
            omega[along] = Fraction(1, 5)
            other = [[Fraction(i == j) for j in range(4)] for i in range(4)]
            # the only direction that counts is that of the point (ω/k1, side · offset)
            normal = [claim.k1 / omega[along], side / claim.offset]
            for i in (0, 1):
                for j in (0, 1):
                    other[i][j] = normal[i] * normal[j] * Fraction(26, 100) + (i == j) * Fraction(1, 100)
            with pytest.raises(Rejected, match="is not in the region"):
                require_starts(claim, other, (omega[0], omega[1]), Fraction(0))
    require_starts(claim, p, steady.omega, steady.aside)


def test_each_axis_of_the_ultimate_bound_is_checked_to_the_last_digit_for_both_offsets() -> None:
    claim, _, _ = parts(ultimate_bound_m=[1.0, 1.0])
    covariance = [[Fraction(i == j) for j in range(4)] for i in range(4)]
    quarter, zero = Fraction(1, 4), Fraction(0)
    require_bound(claim, covariance, (zero, zero), zero, quarter)
    for omega, beside in (((zero, claim.k1), zero), ((-claim.k1, zero), zero), ((zero, zero), Fraction(51, 100))):
        with pytest.raises(Rejected, match="beyond the claimed ultimate bound"):
            require_bound(claim, covariance, omega, beside, quarter)
    for axis in (0, 1):
        wide = copy.deepcopy(covariance)
        wide[axis][axis] = Fraction(5)
        with pytest.raises(Rejected, match="beyond the claimed ultimate bound"):
            require_bound(claim, wide, (zero, zero), zero, quarter)
    with pytest.raises(Rejected, match="beyond the claimed ultimate bound"):  # √1 is not rounded down
        require_bound(claim, covariance, (zero, zero), zero, 1 + Fraction(1, 10**12))


def test_the_vertices_are_all_ends_of_all_ranges() -> None:
    claim, p, steady = parts("20-lag", lag_s=[0.2, 0.3])
    at = shell(claim, steady, inverse(p), Fraction(1, 2), Fraction(1))
    for mirrored in (True, False):
        loops = list(vertices(claim, at, len(p), aside=Fraction(1, 10), mirrored=mirrored))
        drag = (at.drag[0] + at.drag[1]) / 2
        assert {-drag / loop.A[2][2] for loop in loops} == set(claim.mass)
        assert {1 / loop.B[5][4][0] for loop in loops} == set(claim.lag)
        r = claim.yaw_rate
        assert {loop.A[5][4] for loop in loops} == ({r} if mirrored else {r, -r})
        assert {-loop.desired[1][1] * claim.lookahead for loop in loops} == set(at.steer)
        assert {-loop.desired[0][0] for loop in loops} == set(at.catch)
        asides = {loop.desired[1][0] / -loop.desired[0][0] * claim.lookahead for loop in loops}
        assert asides == ({Fraction(1, 10)} if mirrored else {Fraction(1, 10), Fraction(-1, 10)})
        assert len(loops) == 2 * 2 * len(set(at.steer)) * len(set(at.catch)) * (1 if mirrored else 4)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"cap": 0.165}, "the speed cap is below the steady command"),
        ({"k1": 1.5}, "the law would command backward motion"),
        ({"wait": 0.29}, "the path's target waits"),
        ({"thrust_n": 1.0}, "the steady cruise needs all the thrust"),
    ],
)
def test_a_region_beyond_the_law_is_rejected(changes: dict[str, Any], says: str) -> None:
    claim, p, steady = parts(**changes)
    with pytest.raises(Rejected, match=says):
        shell(claim, steady, inverse(p), Fraction(1, 2), Fraction(1))


def test_a_shell_does_not_begin_at_level_0() -> None:
    claim, p, steady = parts()
    with pytest.raises(Rejected, match="must begin above level 0"):
        shell(claim, steady, inverse(p), Fraction(0), Fraction(1))


def test_the_waiting_of_the_target_counts_both_offsets_and_the_error_of_the_place() -> None:
    claim, _, steady = parts()
    x, y = Fraction(1, 10), Fraction(1, 10)
    for omega in ((Fraction(-1, 10), Fraction(0)), (Fraction(0), Fraction(1, 10))):
        steady = replace(steady, omega=omega, command=(Fraction(14, 100), Fraction(15, 100)))
        reach = 2 * (x + Fraction(1, 10) / claim.k1)
        _commanded(replace(claim, wait=reach), steady, x, y)
        for changed in ({"wait": reach - Fraction(1, 10**9)}, {"wait": reach, "place_error": Fraction(1, 10**9)}):
            with pytest.raises(Rejected, match="target waits"):
                _commanded(replace(claim, **changed), steady, x, y)


def test_the_bounds_of_a_shell_are_on_the_safe_side_to_the_last_digit() -> None:
    """Each of them once more with 40 digits; a root that is rounded to the other side is off by up to 1e-9."""
    claim, p, steady = parts("20-norms-force", place_error_m=0.003)
    high, low, cov = Fraction(7, 10), Fraction(1, 3), inverse(p)
    at = shell(claim, steady, cov, low, high)
    with mp.workdps(40):

        def real(x: Fraction) -> Any:
            return mp.mpf(x.numerator) / x.denominator

        k1, ahead, cap = real(claim.k1), real(claim.lookahead), real(claim.cap)
        m, k_v, linear, quadratic = (
            real(v) for v in (claim.mass_model, claim.k_v, claim.linear_model, claim.quadratic_model)
        )
        least, largest = map(real, steady.command)
        x, y = (mp.sqrt(real(cov[k][k] * high)) for k in (0, 1))
        wide = y + real(steady.aside)
        most = cap * ahead / mp.sqrt(ahead**2 + wide**2)
        steer, catch = (least - k1 * x, min(largest + k1 * x, cap)), (min(k1, (most - largest) / x), k1)
        C = mp.matrix([[real(e) for e in row] for row in cov])

        def norm(rows: Any) -> Any:
            return mp.sqrt(max(mp.eigsy(rows * C * rows.T, eigvals_only=True)))

        def desired(s: Any, k: Any) -> Any:
            return mp.matrix([[-k, 0, 0, 0], [0, -s / ahead, 0, 0]])

        own = mp.matrix([[0, 0, 1, 0], [0, 0, 0, 1]])
        e_desired = max(norm(desired(s, k)) for s in steer for k in catch) * mp.sqrt(real(high))
        speed = largest + real(steady.drift)
        spread = quadratic * (speed + min(cap, speed + e_desired))
        e_own = norm(own) * mp.sqrt(real(high))
        dragged = real(claim.linear[1]) + real(claim.quadratic[1]) * (
            2 * (real(claim.cruise) + real(claim.current)) + e_own
        )
        steepest = m * k_v + linear + 2 * quadratic * cap
        slant = max(mp.sqrt(k1**2 * (1 + (wide / ahead) ** 2) + (steer[1] / ahead) ** 2), cap / ahead)
        off = (mp.sqrt(real(cov[1][1])) + real(steady.aside + claim.place_error)) / ahead
        misled = steepest * mp.sqrt(k1**2 * (1 + off**2) + (cap / ahead) ** 2) * real(claim.place_error)
        held = real(steady.total + claim.force) + misled + m * k_v * real(claim.velocity_error)
        share = mp.mpf(1)
        for slope in (linear, linear + spread):
            for s in steer:
                for k in catch:
                    rows = (m * k_v + slope) * desired(s, k) - m * k_v * own
                    for angle in mp.linspace(0, mp.pi, 33):
                        n = mp.matrix([[mp.cos(angle), mp.sin(angle)]])
                        deviation = mp.sqrt((n * rows * C * rows.T * n.T)[0] * real(high))
                        left = real(claim.thrust) - real(steady.along(*(Fraction(float(abs(c))) for c in n)))
                        share = min(share, left / deviation)
        for found, bound in (
            (real(at.steer[1]), steer[1]), (-real(at.steer[0]), -steer[0]),
            (-real(at.catch[0]), -catch[0]), (real(at.catch[1]), catch[1]),
            (real(at.model_drag[1]), linear + spread), (real(at.drag[1]), dragged),
            (real(at.desired_rate), steepest * slant),
            (real(at.held), held / mp.sqrt(real(low))), (-real(at.thrust_share), -share),
        ):  # fmt: skip
            assert bound <= found <= bound + 0.02 * abs(bound)


def test_the_mirror_image_counts_unless_v_is_the_same_there(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[bool] = []

    def none_of(*_: Any, mirrored: bool, **__: Any) -> list[Any]:
        seen.append(mirrored)
        return []

    monkeypatch.setattr(region, "vertices", none_of)
    monkeypatch.setattr(region, "shell", lambda *_: None)
    monkeypatch.setattr(region, "steady_trim", lambda _: Trim(*((Fraction(0),) * 2,) * 2, *(Fraction(0),) * 4))
    monkeypatch.setattr(region, "require_bound", lambda *_: None)
    whole = document("20-sampled")
    region.check(whole)
    assert seen and all(seen)
    for i in range(4):
        for j in range(i):
            if (i + j) % 2:
                changed = copy.deepcopy(whole)
                changed["proof"]["P"][i][j] = 1e-9
                seen.clear()
                region.check(changed)
                assert seen and not any(seen)


@pytest.mark.parametrize("at", [0, 1, -1])
def test_each_vertex_needs_its_decay(at: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def with_one_that_grows(*given: Any, **more: Any) -> list[Vertex]:
        loops = list(islice(vertices(*given, **more), 3))
        loops[at] = replace(loops[at], A=scaled(Fraction(-1), loops[at].A))
        return loops

    whole = document("20-sampled")
    whole["proof"]["shells"] = [{**whole["proof"]["shells"][-1], "level": 1.0}]
    whole["proof"]["floor"] = document("20-sampled")["proof"]["shells"][-2]["level"]
    whole["claim"]["motion"]["ultimate_bound_m"] = [1.0, 1.0]
    monkeypatch.setattr(region, "vertices", lambda *given, **more: islice(vertices(*given, **more), 3))
    region.check(whole)
    monkeypatch.setattr(region, "vertices", with_one_that_grows)
    with pytest.raises(Rejected, match=f"vertex {at % 3}"):
        region.check(whole)


@pytest.mark.parametrize(
    "name", ["20-norms", "20-sampled", "20-lag", "ranges", "20-norms-force", "20-noise", "current"]
)
def test_the_inclusion_of_a_shell_is_the_loop_of_law_and_vehicle(name: str) -> None:
    """The loop is written a second time for the tests; other ranges and gains are those of a claim of one's own."""
    rng = np.random.default_rng(len(name))
    for share in (0.0, 0.1):
        changed = {
            key: document(name)["claim"]["law"][key] * (1 + share * rng.uniform(-1, 1))
            for key in ("mass_kg", "linear_drag", "quadratic_drag", "k1", "lookahead", "k_v", "cap")
        }
        # the masses of vehicle and law may differ; the region shrinks with the gains
        claim, p, steady = parts(name, **{key: round(x, 6) for key, x in changed.items() if share})
        levels = sorted(rng.uniform(0.01, 0.6, size=2).tolist())
        low, high = (Fraction(str(round(level, 6))) for level in levels)
        covariance = inverse(p)
        at = shell(claim, steady, covariance, low, high)
        check_identity(claim, at, steady, covariance, high, len(p))


BY_CELLS: list[tuple[str, Any]] = [
    ("lag_s", [0.1, 0.1]), ("period_s", 0.05), ("current_m_per_s", 0.01), ("asymmetry", 2.0),
]  # fmt: skip


@pytest.mark.parametrize(("key", "value"), BY_CELLS)
def test_a_proof_by_cells_covers_no_more_than_a_turning_cruise(key: str, value: Any) -> None:
    whole = document("20")
    region._turning(read_claim(whole["claim"]))
    next(part for part in whole["claim"].values() if isinstance(part, dict) and key in part)[key] = value
    claim = read_claim(whole["claim"])
    with pytest.raises(Rejected, match="a proof by cells of headings needs"):
        region._turning(claim)


def test_a_proof_by_cells_has_the_force_and_the_errors_of_its_claim() -> None:
    whole = document("20-noise")
    claim = read_claim(whole["claim"])
    names = ("force", "place_error", "velocity_error")
    own = [getattr(region._turning(claim), name) for name in names]
    assert own == [getattr(claim, name) for name in names] and all(own)


@pytest.mark.parametrize("key", ["linear_drag", "quadratic_drag"])
def test_a_proof_by_cells_needs_the_true_drag_in_the_model(key: str) -> None:
    whole = document("20")
    whole["claim"]["law"][key] = 0.0
    with pytest.raises(Rejected, match="the true drag in the law's model"):
        region._turning(read_claim(whole["claim"]))
    whole["claim"]["vehicle"][key] = [0.0, 0.0]
    region._turning(read_claim(whole["claim"]))


def test_the_factors_of_a_turning_cruise_hold_all_drags_of_the_claim() -> None:
    whole = document("20")
    vehicle, law = whole["claim"]["vehicle"], whole["claim"]["law"]
    for key, low, high in (("linear_drag", 0.5, 1.1), ("quadratic_drag", 0.9, 1.5)):
        vehicle[key] = [low * law[key], high * law[key]]
    for first, second in ((0.5, 1.5),):
        found = region._turning(read_claim(whole["claim"])).drag_factor
        assert [float(f) for f in found] == pytest.approx([first, second])


def test_unknown_keys_and_a_proof_by_cells_that_fails_are_rejected() -> None:
    assert "the certificate must have exactly the keys" in reason({**document("20-norms-force"), "more": 1})
    changed = document("20")
    changed["proof"]["floor"] *= 1e-3
    assert reason(changed)


@pytest.mark.parametrize("name", ["20-norms-force", "20-lag"])
def test_the_matrix_is_that_of_the_form(name: str) -> None:
    """ξ and w are drawn, and each term of the form is computed from what it stands for."""
    claim, p, steady = parts(name)
    at = replace(shell(claim, steady, inverse(p), Fraction(1, 2), Fraction(1)), thrust_share=Fraction(1, 2))
    loop = next(iter(vertices(claim, at, len(p), aside=Fraction(1, 10), mirrored=False)))
    weights, hold = [Fraction(k, 7) for k in (1, 2, 3, 4, 5)], Fraction(3, 11)
    m = rate_matrix(claim, at, p, loop, weights, hold)
    rng, size = np.random.default_rng(3), len(p)
    for _ in range(3):
        draw = [Fraction(int(n)) for n in rng.integers(-9, 10, size=len(m))]
        xi, w = draw[:size], {j: draw[size + 2 * k : size + 2 * k + 2] for k, j in enumerate(sorted(loop.B))}

        def of(rows: Matrix, x: list[Fraction]) -> list[Fraction]:
            return [sum((a * b for a, b in zip(row, x, strict=True)), Fraction(0)) for row in rows]

        def square(x: list[Fraction]) -> Fraction:
            return sum((a * a for a in x), Fraction(0))

        rate = of(loop.A, xi)
        for j, inputs in w.items():
            rate = [a + b for a, b in zip(rate, of(loop.B[j], inputs), strict=True)]
        value, own = quadratic(p, xi), xi[2:4]
        force = [a + b for a, b in zip(of(loop.force, xi), w[1], strict=True)]
        l1, l2, l3, l5, l6 = weights
        bounds = {1: l1 * ((at.model_drag[1] - at.model_drag[0]) / 2) ** 2 * square(of(loop.desired, xi)),
                  2: l2 * square(force) / 16, 3: l3 * ((at.drag[1] - at.drag[0]) / 2) ** 2 * square(own),
                  5: l5 * at.held**2 * value, 6: l6 * at.disturbance**2 * value}  # fmt: skip
        left = {1: l1, 2: l2, 3: l3, 5: l5, 6: l6}
        growth, gain = (
            claim.rate + l5 * at.held**2 + (l6 * at.disturbance**2 if 6 in w else 0),
            claim.mass_model * claim.k_v,
        )
        total = claim.rate * value + 2 * sum((a * b for a, b in zip(of(p, xi), rate, strict=True)), Fraction(0))
        if 4 in w:  # Ẇ + g W ≤ V̇ + g V + h ρ |ḟ|² − (1 − g h) (ρ/h) |e|², |w_4| ≤ (1 + r h) |e| + r h |δF_c|
            h, turn = claim.period, claim.yaw_rate * claim.period
            left[4] = (1 - growth * h) * hold / (h * Fraction(6, 5) * (1 + turn) ** 2)
            bounds[4] = left[4] * 6 * turn**2 * square(force)
            total += h * hold * (Fraction(4, 3) * gain**2 * square(rate[2:4]) + 4 * at.desired_rate**2 * square(own))
        total += sum((bounds[j] - left[j] * square(w[j]) for j in w), Fraction(0))
        assert quadratic(m, draw) == total


def test_a_held_command_needs_a_weight_and_a_short_period() -> None:
    claim, p, steady = parts("20-sampled")
    at = shell(claim, steady, inverse(p), Fraction(1, 2), Fraction(1))
    loop = next(iter(vertices(claim, at, len(p), aside=Fraction(0), mirrored=True)))
    small = [Fraction(1, 10**6)] * 5
    rate_matrix(claim, at, p, loop, small, Fraction(1))
    for other, hold in ((claim, Fraction(0)), (replace(claim, rate=1 / claim.period), Fraction(1))):
        with pytest.raises(Rejected, match="the control period is too long"):
            rate_matrix(other, at, p, loop, small, hold)


@pytest.mark.parametrize(("low", "high"), [(0, 1), (1, 0)])
def test_the_thrust_limit_counts_in_every_direction(low: int, high: int) -> None:
    """One direction needs the most thrust: an axis, or the diagonal on one side, for one of the slopes of the law."""
    claim, _, steady = parts()
    free = Trim(steady.omega, steady.command, *(Fraction(0),) * 4)
    cov = [[Fraction(i == j, 10**9) for j in range(4)] for i in range(4)]
    gain, share = claim.mass_model * claim.k_v, Fraction(1, 2)
    for axis in (0, 1):  # deviation: gain · velocity
        only = copy.deepcopy(cov)
        only[2 + axis][2 + axis] = (claim.thrust / gain / share) ** 2
        found = _thrust_share(claim, free, only, [(Fraction(0), Fraction(0), Fraction(0))], (Fraction(0),), Fraction(1))
        assert share * Fraction(99, 100) < found <= share
    k = Fraction(1)
    cov[0][0] = (claim.thrust / gain / share) ** 2 / 2
    corners = [(Fraction(0), k, Fraction(0)), (Fraction(0), k, claim.lookahead)]  # the second along (1, −1)/√2
    found = _thrust_share(claim, free, cov, [corners[low], corners[high]], (Fraction(0),), Fraction(1))
    assert share * Fraction(99, 100) < found <= share


def test_roots_in_the_bounds_of_a_shell_are_rounded_to_the_safe_side(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawn regions: what one root loses by 1e-9, the others seldom make up for."""
    monkeypatch.setattr(region_inclusion, "_thrust_share", lambda *_: Fraction(1))
    claim, p, steady = parts("20-norms-force", place_error_m=0.003)
    base, rng = inverse(p), np.random.default_rng(4)
    for _ in range(60):
        scale = [Fraction(int(n), 997) for n in (*rng.integers(300, 800, size=2), *rng.integers(300, 900_000, size=2))]
        cov = [[scale[i] * scale[j] * e * (i == j) for j, e in enumerate(row)] for i, row in enumerate(base)]
        high, cap = Fraction(int(rng.integers(500, 997)), 997), Fraction(int(rng.integers(175, 200)), 997)
        drawn = replace(claim, cap=cap)
        at = shell(drawn, steady, cov, Fraction(1, 4), high)
        with mp.workdps(40):
            real = [mp.sqrt(mp.mpf(cov[k][k].numerator) / cov[k][k].denominator) for k in range(4)]
            radius = mp.sqrt(mp.mpf(high.numerator) / high.denominator)

            def exact(x: Fraction) -> Any:
                return mp.mpf(x.numerator) / x.denominator

            ahead, k1, x = exact(claim.lookahead), exact(claim.k1), real[0] * radius
            wide = real[1] * radius + exact(steady.aside)
            own = 2 * exact(claim.cruise + claim.current) + max(real[2], real[3]) * radius
            assert exact(at.drag[1]) >= exact(claim.linear[1]) + exact(claim.quadratic[1]) * own
            most = exact(cap) * ahead / mp.sqrt(ahead**2 + wide**2)
            assert exact(at.catch[0]) <= min(k1, (most - exact(steady.command[1])) / x)
            off = (real[1] + exact(steady.aside + claim.place_error)) / ahead
            steepest = claim.mass_model * claim.k_v + claim.linear_model + 2 * claim.quadratic_model * cap
            change = mp.sqrt(k1**2 * (1 + off**2) + (exact(cap) / ahead) ** 2) * exact(steepest * claim.place_error)
            still = exact(steady.total + claim.force + claim.mass_model * claim.k_v * claim.velocity_error)
            assert exact(at.held) >= 2 * (still + change)


def test_the_share_of_a_thrust_deviation_stays_below_the_limit_to_the_last_digit() -> None:
    """What remains of the thrust lies between √g, the deviation, and a root of g that is rounded down."""
    claim, _, steady = parts()
    free = Trim(steady.omega, steady.command, *(Fraction(0),) * 4)
    gain, digits = claim.mass_model * claim.k_v, 10**9
    for number in range(200, 212):
        g = Fraction(number)
        cov = [[g / gain**2 * (i == j == 2) for j in range(4)] for i in range(4)]
        fine = Fraction(isqrt(number * digits**4), digits**2)
        middle = (fine + Fraction(isqrt(number * digits**2), digits)) / 2
        tight = replace(claim, thrust=middle / 2)
        share = _thrust_share(tight, free, cov, [(Fraction(0),) * 3], (Fraction(0),), Fraction(1))
        assert share**2 * g <= tight.thrust**2


# the steady cruise


def test_a_parabola_is_largest_at_an_end_or_at_its_top() -> None:
    one, two = Fraction(1), Fraction(2)
    assert region_trim._parabola(one, -one, Fraction(0), one) == Fraction(1, 4)
    assert region_trim._parabola(one, one, Fraction(0), two) == 6 == region_trim._parabola(one, one, two, Fraction(0))


def test_the_term_that_is_not_affine_is_that_of_the_largest_change_of_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    claim = parts()[0]
    claim = replace(claim, linear_model=claim.linear_model * 2)
    monkeypatch.setattr(region_trim, "_largest", lambda _: Fraction(0))
    found = region_trim.trim(claim)
    assert abs(found.omega[0]) != abs(found.omega[1])
    assert found.total == claim.quadratic_model * max(map(abs, found.omega)) ** 2


def test_the_largest_backward_force_is_0_if_the_force_points_forward() -> None:
    claim = parts()[0]
    assert steady_trim(claim).backward == 0 < steady_trim(replace(claim, current=Fraction(1, 100))).backward


def test_a_steady_command_that_may_point_backwards_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    claim = replace(parts()[0], current=Fraction(1, 100))
    monkeypatch.setattr(region_trim, "_flow_bounds", lambda c: (-c.cruise, *(Fraction(0),) * 3))
    with pytest.raises(Rejected, match="may point backwards"):
        steady_trim(claim)

"""The theorem: NSB is strict priority for all references exactly when the commutators vanish."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.priority.diagnosis.laws import (
    TOLERANCE,
    commutator_norms,
    nsb_velocities,
    strict_velocities,
)
from tests.oracles.priority_draws import draw_levels
from tests.oracles.priority_references import printed_law

N = 4
seeds = st.integers(0, 2**32 - 1)
PROBLEMS = 120


def equals_strict_priority(jacobians, tol=TOLERANCE):
    return bool((commutator_norms(jacobians) <= tol).all())


def draw(rng):
    """1 … 8 levels of 1–5 rows: about half of the problems commute; many are deficient, doubled, switched off."""
    basis = np.linalg.qr(rng.normal(size=(N, N)))[0] if rng.random() < 0.5 else np.eye(N)
    tidy, made = rng.random() < 0.6, []
    for _ in range(rng.integers(1, 9)):
        k = int(rng.integers(1, N + 1))
        J = shared_axes(rng, basis, k) if tidy and rng.random() < 0.93 else loose(rng, k)
        kind = rng.random()
        if made and kind < 0.2:  # a row of a level above
            J = np.vstack([made[rng.integers(len(made))][:1], J[: rng.integers(0, N)]])
        elif made and kind < 0.3:
            J = made[rng.integers(len(made))].copy()
        elif kind < 0.35:
            J = 0.0 * J
        made.append(J * (10.0 ** rng.uniform(-3, 3) if rng.random() < 0.2 else 1.0))
    return made


def shared_axes(rng, basis, k):
    """Rows in the span of some common axes, weighted along them, some by 0."""
    turned = np.linalg.qr(rng.normal(size=(k, k)))[0]
    return turned @ np.diag(rng.choice([0.0, 0.5, 1.0, 2.0], k)) @ basis[rng.permutation(N)[:k]]


def loose(rng, k):
    J = rng.normal(size=(k, N))
    if rng.random() < 0.3:
        J = rng.normal(size=(k, 1)) @ rng.normal(size=(1, N))
    elif rng.random() < 0.2 and k > 1:
        J[1] = J[0]
    return J


def reference_strict(jacobians, x):
    """Strict priority by least squares inside an explicit basis of what the levels above leave."""
    v, free = np.zeros(N), np.eye(N)
    for J, wanted in zip(jacobians, x, strict=True):
        size = np.linalg.norm(J, 2)
        if size == 0.0 or free.shape[1] == 0:
            continue
        inside = J @ free
        _, s, right = np.linalg.svd(inside)
        kept = np.flatnonzero(s > 1e-10 * size)
        step = np.linalg.lstsq(inside @ right[kept].T, wanted - J @ v, rcond=None)[0]
        v = v + free @ (right[kept].T @ step)
        free = free @ right[kept.size :].T
    return v


def gap(jacobians):
    """Largest difference of the two laws over unit references of every row, relative to their size."""
    ends = np.cumsum([0] + [len(J) for J in jacobians])
    one = np.eye(ends[-1])
    x = [
        one[:, a:b] * max(np.linalg.norm(J, 2), 1e-300) for J, a, b in zip(jacobians, ends[:-1], ends[1:], strict=True)
    ]
    by_nsb, strict = nsb_velocities(jacobians, x), strict_velocities(jacobians, x)
    return np.abs(by_nsb - strict).max() / max(1.0, np.abs(strict).max())


def test_the_laws_agree_for_all_references_exactly_when_the_commutators_vanish():
    rng, agree, differ = np.random.default_rng(0), [], []
    for _ in range(PROBLEMS):
        jacobians = draw(rng)
        (agree if equals_strict_priority(jacobians) else differ).append(gap(jacobians))
    assert min(len(agree), len(differ)) > PROBLEMS // 3
    assert max(agree) <= 1e-9
    assert min(differ) >= 1e-6


def test_a_small_tilt_is_noticed_in_both_places():
    for tilt in (1e-3, 1e-5, 1e-7):
        jacobians = [np.array([[1.0, 0, 0, 0]]), np.array([[tilt, 1.0, 0, 0]])]
        assert commutator_norms(jacobians)[1] == pytest.approx(tilt, rel=1e-4)
        assert gap(jacobians) == pytest.approx(tilt, rel=1e-4)
        assert not equals_strict_priority(jacobians)
        assert equals_strict_priority(jacobians, tol=2 * tilt)


def test_short_rows_count_as_much_as_long_ones():
    coupled = np.array([[1.0, 0, 0, 0], [0, 1e-6, 1e-6, 0]])
    jacobians = [np.array([[0, 1.0, 0, 0]]), coupled]
    plain = coupled.T @ coupled @ np.diag([0, 1.0, 0, 0])
    assert np.abs(plain - plain.T).max() < 1e-11  # the plain commutator looks like nothing
    assert commutator_norms(jacobians)[1] == pytest.approx(0.5)
    x = [np.zeros(1), np.array([0.0, 1e-6])]
    assert np.abs(nsb_velocities(jacobians, x) - strict_velocities(jacobians, x)).max() == pytest.approx(0.5)


def test_rank_plays_no_part():
    first, second = np.array([[1.0, 0, 0, 0], [2.0, 0, 0, 0]]), np.array([[0, 1.0, 1.0, 0], [0, 2.0, 2.0, 0]])
    inside = np.array([[1.0, 1.0, 1.0, 0]])  # in the span of both, and no eigenvector of anything
    assert equals_strict_priority([first, second, inside])
    assert equals_strict_priority([first, second, np.zeros((2, N)), second, np.eye(N), inside])
    assert not equals_strict_priority([inside, first])
    assert not equals_strict_priority([inside, np.zeros((1, N)), second])


@given(seeds)
def test_one_row_gives_half_the_sine_of_twice_the_angle(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, N))
    cosine = abs(a @ b) / np.linalg.norm(a) / np.linalg.norm(b)
    found = commutator_norms([a[None], 1e5 * b[None]])
    assert found == pytest.approx([0.0, 0.5 * np.sin(2 * np.arccos(np.clip(cosine, -1, 1)))], abs=1e-7)


@given(seeds)
def test_norms_do_not_see_frame_units_or_rows_turned_within_a_level(seed):
    rng = np.random.default_rng(seed)
    jacobians = [lv.J for lv in draw_levels(rng, most=5, conditioned=True, deficient=False)]
    frame = np.linalg.qr(rng.normal(size=(N, N)))[0]
    turned = [
        np.linalg.qr(rng.normal(size=(len(J), len(J))))[0] @ J @ frame * 10.0 ** rng.uniform(-6, 6) for J in jacobians
    ]
    norms = commutator_norms(jacobians)
    assert (norms <= np.sqrt(N / 8) + 1e-12).all()
    assert np.abs(commutator_norms(turned) - norms).max() <= 1e-8


@given(seeds)
def test_many_samples_at_once_are_the_single_ones(seed):
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, N + 2, size=rng.integers(1, 6))
    many = [rng.normal(size=(3, k, N)) for k in sizes]
    x = [rng.normal(size=(3, k)) for k in sizes]
    strict, swept, norms = strict_velocities(many, x), nsb_velocities(many, x), commutator_norms(many)
    for i in range(3):
        one, at = [J[i] for J in many], [part[i] for part in x]
        scale = 1.0 + np.abs(strict[i]).max()
        assert np.abs(strict[i] - strict_velocities(one, at)).max() <= 1e-12 * scale
        assert np.abs(norms[i] - commutator_norms(one)).max() <= 1e-12
        assert np.abs(swept[i] - nsb_velocities(one, at)).max() <= 1e-12 * (1.0 + np.abs(swept[i]).max())


@given(seeds)
def test_both_laws_equal_their_references(seed):
    made = draw_levels(np.random.default_rng(seed), most=8, conditioned=True)
    jacobians, x = [lv.J for lv in made], [lv.x for lv in made]
    size = 1 + sum(np.linalg.norm(np.linalg.pinv(J, rcond=1e-10) @ b) for J, b in zip(jacobians, x, strict=True))
    assert np.abs(nsb_velocities(jacobians, x) - printed_law(made)).max() <= 1e-12 * size
    strict = strict_velocities(jacobians, x)
    assert np.abs(strict - reference_strict(jacobians, x)).max() <= 1e-7 * (1 + np.abs(strict).max())


def test_bad_jacobians_name_the_level():
    good = np.ones((1, N))
    with pytest.raises(InputError, match="level 2: J has shape"):
        commutator_norms([good, np.ones((1, 3))])
    with pytest.raises(InputError, match="level 2: J is not finite"):
        equals_strict_priority([good, good * np.nan])
    with pytest.raises(InputError, match="has no level"):
        commutator_norms([])

"""Proof that a task is independent of other tasks on a whole region, by a lower bound on the sine of their angle."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from surctl.certcheck import check_document
from surctl.errors import InputError
from surctl.priority.diagnosis.findings import Region
from surctl.tasks import Stack
from surctl.verification.claim import Claim, Variable
from surctl.verification.proving import prove
from surctl.verification.stack.simplification import simplified

__all__ = ["independence_claims", "prove_sine", "prove_strength"]

_LEAST_STRENGTH = 1e-6  # least det J Jᵀ of a task whose Jacobian counts as regular


def prove_sine(stack: Stack, region: Region, above: Sequence[int], i: int, *, sine: float, time_limit: float) -> float:
    """Return `sine` if the product of sines between task i and the tasks above is proved to be ≥ `sine`, else 0.

    The proof is by interval branch and bound, and the independent checker must accept it.
    """
    for claim in independence_claims(stack, region, above, i, sine=sine):
        certificate = prove(claim, time_limit=time_limit).certificate
        if certificate is None or not check_document(certificate).accepted:
            return 0.0
    return sine


def prove_strength(stack: Stack, region: Region, i: int, *, time_limit: float) -> bool:
    """Return whether the Jacobian J of task i is proved to be regular on the whole region (det J Jᵀ ≥ 1e-6)."""
    strength = _gram(_jacobian(stack, region, i))
    if strength.is_constant():
        return bool(float(strength) >= _LEAST_STRENGTH)
    certificate = prove(_claim(region, "strength", ca.SX(_LEAST_STRENGTH), strength), time_limit=time_limit).certificate
    return certificate is not None and check_document(certificate).accepted


def independence_claims(
    stack: Stack, region: Region, above: Sequence[int], i: int, *, sine: float
) -> tuple[Claim, ...]:
    """Return three claims: det[A; B][A; B]ᵀ ≥ s² det(AAᵀ) det(BBᵀ), det AAᵀ > 0 and det BBᵀ > 0, where s = `sine`.

    A holds the Jacobians of the tasks above, and B is the Jacobian of task i. Both are expressed in {E}, where they do
    not depend on ψ.
    """
    A, B = ca.vertcat(*[_jacobian(stack, region, k) for k in above]), _jacobian(stack, region, i)
    if A.shape[0] + B.shape[0] > A.shape[1]:
        return (_claim(region, "dimension", ca.SX(1), ca.SX(0)),)  # a false claim: more Jacobian rows than velocities
    both, first, second = (_gram(part) for part in (ca.vertcat(A, B), A, B))
    floor = ca.SX(_LEAST_STRENGTH)
    return (
        _claim(region, "strength-above", floor, first),
        _claim(region, "strength", floor, second),
        _claim(region, "independence", sine**2 * first * second, both),
    )


def _jacobian(stack: Stack, region: Region, k: int) -> ca.SX:
    """Return the Jacobian of task k by the pose, without the branches that interval arithmetic decides on the region.

    Branches are min, max, abs and select.
    """
    sigma = stack.tasks[k].sigma
    try:
        smooth = simplified(sigma, region, tuple(map(_name, region.names)))
    except InputError:  # an operation that the claim grammar does not have: the prover reports it
        smooth = sigma
    return ca.jacobian(smooth, stack.eta)


def _gram(A: ca.SX) -> ca.SX:
    product = ca.densify(A @ A.T)
    return ca.simplify(product if product.numel() == 1 else ca.det(product))


def _claim(region: Region, name: str, left: ca.SX, right: ca.SX) -> Claim:
    used = {s.element_hash() for s in ca.symvar(ca.vertcat(left, right))}
    variables = tuple(
        Variable(_name(name), region.symbols[k], "1", float(region.lower[k]), float(region.upper[k]), "of the region")
        for k, name in enumerate(region.names)
        if region.symbols[k].element_hash() in used or k == 0
    )
    return Claim(name, "a task is independent of the tasks above it", "(16)", (), "proved", variables, left, right, "1")


def _name(name: str) -> str:
    # the certificate's grammar accepts only letters, digits and _
    return "".join(c if c.isalnum() or c == "_" else "_" for c in name)

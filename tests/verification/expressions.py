"""Random expressions of the claim grammar, and what they are worth to sixty digits."""

from collections.abc import Mapping
from fractions import Fraction

from hypothesis import strategies as st
from mpmath import mp, mpf

from surctl.verification.formula import Node, number, ordered, variable

NAMES = ("x", "y", "z")
ONE_ARGUMENT = (
    "neg", "sqrt", "sin", "cos", "atan", "acos", "asin", "tan", "exp", "log", "sinh", "cosh", "tanh",
)  # fmt: skip
FRACTIONS = (Fraction("0.5"), Fraction("1.5"), Fraction("-1.5"), Fraction(1, 3), Fraction("-0.1"), Fraction("2.7"))


class NoValue(Exception):
    """Not defined there."""


class TooClose(Exception):
    """Two numbers are equal, or their difference is rounding."""


def expressions(*, branching: bool = True) -> st.SearchStrategy[Node]:
    """Expressions in x, y, z of moderate depth."""
    leaves = st.one_of(
        st.sampled_from([variable(n) for n in NAMES]),
        st.sampled_from(["0", "1", "2", "-0.5", "0.1", "3.7", "1e-3"]).map(lambda t: number_of(t)),
        st.just(Node("pi")),
    )

    def grown(inner: st.SearchStrategy[Node]) -> st.SearchStrategy[Node]:
        two = st.tuples(st.sampled_from(["add", "sub", "mul", "div", "atan2"]), inner, inner)
        one = st.tuples(st.sampled_from(ONE_ARGUMENT), inner)
        powers = st.tuples(inner, st.one_of(st.integers(-3, 4), st.sampled_from(FRACTIONS)))
        made = [
            two.map(lambda t: Node(t[0], t[1:])),
            one.map(lambda t: Node(t[0], t[1:])),
            powers.map(lambda t: Node("pow" if t[1] == int(t[1]) else "powr", (t[0],), Fraction(t[1]))),
        ]
        if branching:
            made.append(st.tuples(st.sampled_from(["min", "max"]), inner, inner).map(lambda t: Node(t[0], t[1:])))
            made.append(inner.map(lambda a: Node("abs", (a,))))
            made.append(st.tuples(inner, inner, inner, inner).map(lambda t: Node("select", t)))
        return st.one_of(made)

    return st.recursive(leaves, grown, max_leaves=8)


def number_of(text: str) -> Node:
    return number(Fraction(text))


def worth(root: Node, at: Mapping[str, object]) -> mpf:
    """The value to sixty digits; NoValue where there is none, TooClose where rounding decides."""
    with mp.workdps(60):
        made = {}
        for node in ordered(root):
            made[node] = mpf(_one(node, [made[a] for a in node.args], at))
        return made[root]


def _one(node, args, at):
    match node.op:
        case "num":
            return mpf(node.value.numerator) / node.value.denominator
        case "pi":
            return +mp.pi
        case "var":
            return at[node.name]
        case "add":
            return args[0] + args[1]
        case "sub":
            return args[0] - args[1]
        case "mul":
            return args[0] * args[1]
        case "div":
            if args[1] == 0:
                raise NoValue
            return args[0] / args[1]
        case "neg":
            return -args[0]
        case "pow":
            if args[0] == 0 and node.value < 0:
                raise NoValue
            return args[0] ** int(node.value)
        case "sqrt":
            if args[0] < 0:
                raise NoValue
            return mp.sqrt(args[0])
        case "sin" | "cos" | "atan" | "tanh":
            return getattr(mp, node.op)(args[0])
        case "tan":
            if abs(mp.cos(args[0])) < mpf(10) ** -40:
                raise TooClose
            return mp.tan(args[0])
        case "exp" | "sinh" | "cosh":
            if abs(args[0]) > 1e5:  # the prover refuses larger arguments
                raise TooClose
            return getattr(mp, node.op)(args[0])
        case "log":
            if args[0] <= 0:
                raise NoValue
            return mp.log(args[0])
        case "powr":
            if args[0] < 0 or (args[0] == 0 and node.value < 0):
                raise NoValue
            return args[0] ** (mpf(node.value.numerator) / node.value.denominator)
        case "acos" | "asin":
            if abs(args[0]) > 1:
                raise NoValue
            return getattr(mp, node.op)(args[0])
        case "atan2":
            if args[0] == 0 and args[1] == 0:
                raise NoValue
            return mp.atan2(args[0], args[1])
        case "abs":
            return abs(args[0])
        case "min":
            return min(args)
        case "max":
            return max(args)
    if abs(args[0] - args[1]) < mpf(10) ** -40:
        raise TooClose
    return args[2] if args[0] <= args[1] else args[3]

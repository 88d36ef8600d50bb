"""Constants, arrays and variables of the priority kernel."""

from __future__ import annotations


class Memory:
    """Constants, arrays and variables of the kernel; sizes are in `hierarchy`."""

    n: int  # velocities
    quarter: int
    x: int  # unknowns, with both openings, padded to a multiple of 4
    m: int  # limits
    k: int  # rows of all levels, with the two of the openings, padded to a multiple of 4
    p: int  # levels, with the two of the openings
    b: int  # rows of the largest level
    r: int  # rows of the table T
    cap: int  # iterations
    earliest: int  # the first set-based level
    damped: int  # 1: module `damping`; else 0, and its branches are not part of the procedure
    budget: int  # operations after which the search ends; 0: none, as for `damped`
    J: list[float]
    lower: list[float]
    upper: list[float]
    rows: list[float]
    box: list[float]
    damping: list[float]
    velocity: list[float]
    target: list[float]
    active: list[float]
    multipliers: list[float]
    opening: list[float]
    status: list[float]
    count: list[float]
    first: list[int]  # first row of each level, and the end
    is_set: list[int]
    level_of: list[int]
    At: list[float]  # limits of length 1: entry j of limit i at j·m + i
    lo: list[float]
    up: list[float]
    lo_true: list[float]
    up_true: list[float]
    column: list[int]  # of the opening of a limit, or −1
    T: list[float]
    B: list[float]
    L: list[float]
    V: list[float]  # reflections of the levels
    tau: list[float]
    h: list[float]
    sums: list[float]
    y: list[float]
    z: list[float]
    g: list[float]
    pivot: list[int]
    many: list[int]  # rows of each level that are on
    start: list[int]  # first column of each level behind W
    used: list[int]  # reflections before each level
    left: list[int]  # whether a level has a QR from the left
    rank: list[int]
    QR: list[float]
    diagonal: list[float]
    weight: list[float]  # of the reflections from the left
    side_d: list[float]
    norms: list[float]
    rhs: list[float]
    rest: list[float]
    scale: list[float]
    on: list[int]  # 1: the row belongs to its level; −1: at its lower bound
    lock: list[int]
    lock_set: list[int]
    inside: list[int]
    W: list[int]
    side: list[int]
    v: list[float]
    goal: list[float]
    step: list[float]
    lam: list[float]
    mu: list[float]
    speed: list[float]
    value: list[float]
    slack: list[float]
    toward: list[int]
    near: list[int]  # limits that v + step exceeds
    margin: list[float]  # to the upper bounds, then to the lower ones
    hits: int  # number of limits in `near`
    nearest: float  # share of the step up to the first limit
    slack_set: list[float]
    speed_set: list[float]
    toward_set: list[int]
    gap: list[float]
    gap_set: list[float]
    spread: list[float]
    d: list[float]
    N: int
    spent: int  # operations so far, see module `bound`
    w: int
    valid: int
    hard: int
    soft: int
    top: int
    factor: float
    head: float  # first entry of the normal of a reflection
    size: float
    moved: int
    still: int
    bad: int
    reached: int
    block: int
    block_set: int
    block_side: int
    turns: int
    R: list[float]  # of a damped level
    ridge: list[float]  # squared weight of v in each level
    low: list[float]  # bounds of set-based rows, as the damped levels leave them
    high: list[float]
    f: int  # columns of Q before those of W, along which the damped levels keep v
    skip: int  # levels at the top that need no elimination
    last: int  # number of the damped levels so far, and of those above
    sure: int
    limited: int
    place: int

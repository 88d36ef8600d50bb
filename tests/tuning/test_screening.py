from dataclasses import replace

import numpy as np
import pytest

from surctl.marine.tuning import Goal, figures
from surctl.marine.tuning.evaluation import fresh
from surctl.tuning import cegis, search, tune
from surctl.tuning.cegis import Round, _chosen, _ended
from surctl.tuning.chunked import Journal
from surctl.tuning.gain_search import descend
from surctl.tuning.montecarlo import Counterexample, MonteCarlo, monte_carlo, reduced_pool, screen, stored_figures
from tests.tuning.synthetic import CLEAR, GAINS, NEAR, THRIFT, Loop, heavy, install, request


def test_the_descent_ends_at_the_least_score_there_is(monkeypatch):
    install(monkeypatch)
    rng = np.random.default_rng(0)
    asked = request()
    pool = asked.judge({s.name: np.append(GAINS[s.name], s.place(rng.uniform(size=12))) for s in asked.space})
    start = pool.evaluation.normalised[0]
    k_v, k1 = (a.ravel() for a in np.meshgrid(np.geomspace(0.5, 4, 120), np.geomspace(0.1, 1.2, 120)))
    grid = asked.judge({"k_v": k_v, "k1": k1})
    whole = descend(asked, pool, trials=120, journal=Journal(None))
    best = whole.best(start)
    assert whole.feasible[best]
    assert whole.score(start)[best] <= 1.001 * grid.score(start)[grid.best(start)] < pool.score(start)[pool.best(start)]
    for span in asked.space:
        assert (whole.sets[span.name] >= span.low).all() and (whole.sets[span.name] <= span.high).all()


def test_a_descent_of_one_gain_and_from_an_infeasible_start(monkeypatch):
    install(monkeypatch)
    asked = request((CLEAR, NEAR), k1=(0.13, 3.0))
    pool = asked.judge({"k1": np.array([2.5])})
    assert not pool.feasible[0]
    whole = descend(asked, pool, trials=80, journal=Journal(None))
    best = whole.best(pool.evaluation.normalised[0])
    assert whole.feasible[best]
    # as near to the path as the clearance lets it
    assert whole.evaluation.figure[best, 0] == pytest.approx(CLEAR.limit, abs=1e-4)


def test_what_is_left_withstands_every_training_run(monkeypatch):
    install(monkeypatch, Loop(mass=0.05))
    asked = heavy()
    pool = search(asked, trials=64)
    left = screen(asked, pool, runs=500)
    assert left.counterexamples and all(c.normalised > 1 for c in left.counterexamples)
    assert {c.seed for c in left.counterexamples} <= set(range(5_000_000, 5_000_500))
    assert left.request.conditions[: len(asked.conditions)] == asked.conditions
    kept = left.request.conditions[len(asked.conditions) :]
    assert {(c.seed, goal) for c in kept for goal in c.goals} == {(c.seed, c.goal) for c in left.counterexamples}
    assert len({c.seed for c in kept}) == len(kept), "what refutes two sets is flown once"
    training = fresh(asked.cases, runs=500, first=5_000_000)
    assert monte_carlo(figures, asked.goals, training, left.gains).refuted == ()
    start = pool.evaluation.normalised[0]
    first = pool.gains(pool.best(start))
    assert left.gains != first, "the best of a few runs is on their edge"
    judged = reduced_pool(left.request, pool, left.gains, first)
    assert judged.feasible[-2] and not judged.feasible[-1]
    # none that the search held for better withstands what was found
    better = pool.merit(start) < left.request.judge({k: np.array([v]) for k, v in left.gains.items()}).merit(start)[0]
    assert not left.request.judge(pool.subset(np.flatnonzero(better).tolist()).sets).feasible.any()


def test_training_runs_resume_after_an_interruption_with_a_line_of_their_pace(monkeypatch, tmp_path):
    loop, told = Loop(mass=0.05), []
    install(monkeypatch, loop)
    monkeypatch.setattr("surctl.tuning.montecarlo._PAUSE", -1.0)
    asked, journal = heavy(), Journal(tmp_path)
    pool = search(asked, trials=64)
    whole, before = screen(asked, pool, runs=1000), loop.runs

    def stopping(text):
        told.append(text)
        if len(told) == 2:
            raise KeyboardInterrupt

    with journal.held(), pytest.raises(KeyboardInterrupt):
        screen(asked, pool, runs=1000, figures=stored_figures(asked, journal, stopping))
    assert told[1].startswith("test run 512/1000, ") and " runs/s, ETA " in told[1]
    assert loop.runs - before == 512
    before = loop.runs
    alone = screen(asked, pool, runs=1000, figures=stored_figures(asked, Journal(None), told.append))
    every, before = loop.runs - before, loop.runs
    with journal.held():
        left = screen(asked, pool, runs=1000, figures=stored_figures(asked, journal, told.append))
    assert loop.runs - before == every - 512
    assert left.gains == alone.gains == whole.gains
    assert left.counterexamples == alone.counterexamples == whole.counterexamples


def test_with_nothing_left_the_one_that_misses_least_is_told(monkeypatch):
    install(monkeypatch, Loop(mass=0.3))
    asked = heavy()
    pool = search(asked, trials=32)
    told = []
    left = screen(asked, pool, runs=500, progress=told.append)
    judged = left.request.judge({k: np.array([v]) for k, v in left.gains.items()})
    assert not judged.feasible[0] and "500 training runs" in told[-1]


def round_of(score, *, refuted=(), training=False, feasible=True, missed=()):
    run = Counterexample("keep clear", "c", 5, {}, 0.01, 2.0)
    found = tuple(replace(run, goal=name) for name in refuted)
    verified = MonteCarlo(10, (1, 10), {}, {}, found)
    return Round({"k1": 0.3, "k_v": 1.5}, score, feasible, tuple(missed), (run,) * training, verified, (), ())


@pytest.mark.parametrize(
    ("done", "ended"),
    [
        ([round_of(0.9)], True),  # nothing refutes it and nothing was learnt
        ([round_of(0.9, training=True)], False),  # a better one may be near what was left
        ([round_of(0.9, refuted=["keep clear"])], False),
        ([round_of(0.9, training=True), round_of(0.85, training=True)], False),
        ([round_of(0.9, training=True), round_of(0.899, training=True)], True),
        ([round_of(0.8, refuted=["keep clear"]), round_of(0.9, training=True)], False),
        ([round_of(2.0, refuted=["stay near"], missed=["stay near"])], True),  # missed over the known runs as well
        ([round_of(2.0, missed=["keep clear"], feasible=False)], False),  # it is searched for longer, once
        ([round_of(2.0, missed=["keep clear"], feasible=False)] * 2, True),
        ([round_of(2.0, refuted=["keep clear"], missed=["keep clear"], feasible=False)], False),
        ([round_of(2.0, refuted=["keep clear"], missed=["keep clear"], feasible=False)] * 2, True),
        ([round_of(2.0, training=True, feasible=False), round_of(2.0, feasible=False)], False),
        ([round_of(2.0, refuted=["keep clear"], training=True, missed=["keep clear"], feasible=False)], False),
    ],
)
def test_when_another_round_is_worth_while(done, ended):
    assert _ended(done) is ended


def test_the_best_of_the_rounds_that_nothing_refutes_is_chosen(monkeypatch):
    install(monkeypatch)
    found = request().judge({"k1": np.array([0.3, 0.5, 0.4]), "k_v": np.array([1.5, 1.5, 1.5])})
    start = found.evaluation.normalised[0]
    order = np.argsort(found.merit(start)).tolist()
    sound = [round_of(1.0) for _ in range(3)]
    assert _chosen(sound, found, start) == order[0]
    sound[order[0]] = round_of(1.0, refuted=["keep clear"])
    assert _chosen(sound, found, start) == order[1]
    assert _chosen([round_of(1.0, refuted=["keep clear"])] * 3, found, start) == order[0]


def test_hard_goals_that_a_search_does_not_meet_are_searched_for_alone(monkeypatch):
    install(monkeypatch)
    asked = request()
    run = replace(asked.conditions[0], seed=7)
    asked = replace(
        asked, conditions=(*asked.conditions, *(replace(run, goals=(name,)) for name in ("keep clear", "stay near")))
    )
    looked = []

    def searched(one, **given):
        looked.append((one, given["first"]))
        sets = {"k1": np.array([1.5, 2.0]), "k_v": np.array([0.5, 0.6])} if len(looked) == 1 else {**clear}
        return one.judge(sets)

    monkeypatch.setattr(cegis, "search", searched)
    clear = {"k1": np.array([1.5, 0.3]), "k_v": np.array([0.5, 1.5])}
    pool = cegis._searched(asked, [round_of(1.0)], 32, Journal(None), lambda _: None)
    assert pool.feasible.tolist() == [False, False, True, False], "the best of the second search come first"
    (_, (alone, first)) = looked
    assert alone.goals == (CLEAR,) and [c.goals for c in alone.conditions] == [None, None, ("keep clear",)]
    assert sorted(one["k1"] for one in first) == [1.5, 2.0]
    looked.clear()
    clear = {"k1": np.array([0.3]), "k_v": np.array([1.5])}
    monkeypatch.setattr(cegis, "search", lambda one, **given: looked.append(one) or one.judge(clear))
    cegis._searched(asked, [round_of(1.0)], 32, Journal(None), lambda _: None)
    assert len(looked) == 1, "met at once"


def test_what_is_chosen_is_what_nothing_refuted(monkeypatch):
    install(monkeypatch, Loop(mass=0.05))
    tuning = tune(heavy(), trials=64, rounds=4, runs=100)
    assert tuning.result is tuning.rounds[tuning.chosen] and not tuning.result.refuted
    assert {n: float(v[0]) for n, v in tuning.tuned.sets.items()} == dict(tuning.result.gains)
    flown = tuning.request.conditions
    assert monte_carlo(figures, tuning.request.goals, flown, tuning.result.gains).refuted == ()


def test_more_seeds_than_there_are_is_told(monkeypatch):
    from surctl.errors import InputError

    install(monkeypatch)
    with pytest.raises(InputError, match="more seeds than are available"):
        tune(request(), runs=1_000_000)


def test_a_goal_over_the_mean_is_met_over_the_training_runs(monkeypatch):
    install(monkeypatch, Loop(mass=0.05))
    asked = heavy((Goal("clear on average", "min_clearance_m", "m", 0.07, "at least", "hard", over="mean"), THRIFT))
    pool = search(asked, trials=32)
    left = screen(asked, pool, runs=500)
    training = fresh(asked.cases, runs=500, first=5_000_000)
    assert monte_carlo(figures, asked.goals, training, left.gains).refuted == ()
    first = pool.gains(pool.best(pool.evaluation.normalised[0]))
    assert monte_carlo(figures, asked.goals, training, first).refuted, "the best of one run does not"

import json
import resource
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.marine.control import law_ref, load_gains, write_gains
from surctl.marine.tuning import Goal, conditions, evaluate, figures, gain_ranges, tuned_gains
from surctl.marine.tuning.evaluation import fresh
from surctl.marine.tuning.request import expected_to_hold, refuted_claims
from surctl.tuning import Counterexample, search, summary, tune
from surctl.tuning.chunked import Journal
from surctl.tuning.gain_search import demands, minimal_subset
from surctl.tuning.montecarlo import monte_carlo
from surctl.tuning.outcome import advice, misses, tuning_dict
from surctl.tuning.pool import ClaimPoint, Pool, judged
from tests.tuning.synthetic import CLEAR, GAINS, MARGIN, NEAR, THRIFT, Loop, case, heavy, install, request


def same(one, other):
    return all(np.array_equal(one.sets[name], other.sets[name]) for name in one.sets)


def test_ranges_are_derived_and_checked():
    found = {s.name: (s.low, s.high) for s in gain_ranges(GAINS, ["k_v", "brake"])}
    assert found["k_v"] == (1.5 / 4, 6.0)
    assert found["brake"][1] == pytest.approx(1.0) and found["brake"][1] >= 1.0
    span = gain_ranges(GAINS, {"k1": (0.1, 0.9)})[0]
    unit = np.linspace(0, 1, 7)
    for one in (span, *gain_ranges(GAINS, {"k_i": (0.0, 0.5)})):
        assert one.unit(one.place(unit)) == pytest.approx(unit)
        assert one.place(unit[[0, -1]]) == pytest.approx([one.low, one.high])
    for wrong, told in (
        ({"k_w": None}, "did you mean"),
        ({"k_v": (2.0, 1.0)}, "not a range"),
        ({"k_v": (0.0, 1.0)}, "begins at 0, and the gain must be greater"),
        ({"k_i": (-0.1, 1.0)}, "0 ≤ LOW < HIGH"),
        ({"k_v": (1.0, float("nan"))}, "not a range"),
        ({"brake": (0.1, 2.0)}, "above its bound"),
        ({"k_i": None}, "is 0"),
        ({}, "nothing is tuned"),
    ):
        with pytest.raises(InputError, match=told):
            gain_ranges(GAINS, wrong)


def test_a_search_meets_the_hard_goals_and_beats_the_start(monkeypatch):
    install(monkeypatch)
    pool = search(request(), trials=128)
    start = pool.evaluation.normalised[0]
    best = pool.best(start)
    assert pool.feasible[best] and pool.score(start)[best] < 0.99
    assert (pool.evaluation.normalised[best][1:] < start[1:]).all()
    # against a fine grid of the same loop: within a few per cent of the best there is
    k_v, k1 = (a.ravel() for a in np.meshgrid(np.geomspace(0.5, 4, 60), np.geomspace(0.1, 1.2, 60)))
    grid = request().judge({"k_v": k_v, "k1": k1})
    assert pool.score(start)[best] <= 1.02 * grid.score(start)[grid.best(start)]


def test_the_front_is_undominated_and_feasible(monkeypatch):
    install(monkeypatch)
    pool = search(request(), trials=64)
    start = pool.evaluation.normalised[0]
    front = pool.front(start)
    score, effort = pool.score(start), pool.evaluation.effort
    assert len(front) > 2 and pool.feasible[front].all()
    for k in front:
        beaten = pool.feasible & (score <= score[k]) & (effort <= effort[k])
        assert not (beaten & ((score < score[k]) | (effort < effort[k]))).any()


def test_the_same_seed_finds_the_same_and_another_another(monkeypatch):
    install(monkeypatch)
    one = search(request(), trials=32)
    assert same(one, search(request(), trials=32))
    assert not same(one, search(request(seed=1), trials=32))


def test_an_interrupted_search_resumes_to_the_same_end(monkeypatch, tmp_path):
    """Interrupted in the descent, whose iteration is the last two calls; a full disk interrupts a batch, below."""
    calls = 4
    loop = install(monkeypatch)
    whole = search(request(), trials=128)
    runs = loop.runs

    class Stopped(Loop):
        def __call__(self, *args, **kwargs):
            if self.calls > calls:
                raise KeyboardInterrupt
            return super().__call__(*args, **kwargs)

    install(monkeypatch, Stopped())
    with pytest.raises(KeyboardInterrupt):
        search(request(), trials=128, journal=Journal(tmp_path))
    batches = sorted(tmp_path.rglob("*.chunk"))
    batches[2].write_bytes(batches[2].read_bytes()[:-5])  # as a failing disk leaves it
    loop, told = install(monkeypatch), []
    again = search(request(), trials=128, journal=Journal(tmp_path), progress=told.append)
    assert same(whole, again)
    assert np.array_equal(whole.evaluation.normalised, again.evaluation.normalised)
    assert told[0].startswith("64 trials")
    assert loop.runs == runs - 2 * 96, "two runs of each set in the undamaged batches"
    fresh_loop = install(monkeypatch)
    search(request(), trials=128, journal=Journal(tmp_path))
    assert fresh_loop.runs == 0, "finished trials are not flown again"
    longer = install(monkeypatch)
    assert search(request(), trials=160, journal=Journal(tmp_path)).evaluation.effort.size > 0 and longer.runs < runs


def test_a_full_disk_is_one_line_and_the_search_resumes(monkeypatch, tmp_path):
    install(monkeypatch)
    whole = search(request(), trials=96)
    room = resource.getrlimit(resource.RLIMIT_FSIZE)
    search(request(), trials=32, journal=Journal(tmp_path))
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000, room[1]))
    try:
        with pytest.raises(InputError, match=r"tune\.chunks.*cannot be written.*free disk space"):
            search(request(), trials=96, journal=Journal(tmp_path))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, room)
    told = []
    again = search(request(), trials=96, journal=Journal(tmp_path), progress=told.append)
    assert same(whole, again) and told[0].startswith("32 trials of the same request are resumed")


def test_another_request_shares_nothing(monkeypatch, tmp_path):
    install(monkeypatch)
    journal = Journal(tmp_path)
    search(request(), trials=32, journal=journal)
    told = []
    search(request(goals=(CLEAR, NEAR)), trials=32, journal=journal, progress=told.append)
    assert "resumed" not in told[0]


def test_a_folder_in_use_and_one_that_cannot_be_written_are_one_line(monkeypatch, tmp_path):
    install(monkeypatch)
    (tmp_path / "file").write_text("")
    with Journal(tmp_path).held():
        with pytest.raises(InputError, match="another process"):
            tune(request(), trials=32, rounds=1, runs=0, folder=tmp_path)
        with pytest.raises(InputError, match="cannot be written"):
            tune(request(), trials=32, rounds=1, runs=0, folder=tmp_path / "file")


def test_fresh_runs_have_fresh_seeds_and_stay_in_the_ranges():
    cases = [case(), case("tank-static", "sur540-flooded")]
    flown = fresh(cases, runs=101, first=4, tuning=2)
    seeds = [c.seed for c in flown]
    assert seeds == list(range(20_000_004, 20_000_105))
    assert {c.case.name for c in flown} == {c.name for c in cases}
    for c in flown:
        for name, value in c.plant.items():
            low, high = c.case.vehicle.parameters[name.removeprefix("plant.")].range
            assert low <= value <= high
    masses = [c.plant["plant.m11"] for c in flown if c.case is cases[1]]
    assert min(masses) < 60 and max(masses) > 115
    assert flown == fresh(cases, runs=101, first=4, tuning=2)


def test_every_other_fresh_run_of_a_case_that_seeds_change_flies_its_own_vehicle():
    flown = fresh([case("pool-static", "sur540-flooded")], runs=40, first=0)
    assert [bool(c.plant) for c in flown] == [True, False] * 20


def test_a_goal_about_the_nominal_plant_leaves_the_others_out(monkeypatch):
    install(monkeypatch, Loop(mass=0.2))
    flown = conditions([case("tank-static", "sur540-flooded")], seeds=[0])
    sets = {"k_v": np.array([2.0]), "k1": np.array([0.3])}
    goals = (CLEAR, replace(CLEAR, name="own", plants="nominal"), replace(MARGIN, plants="nominal"))
    every, own, margin = evaluate(goals, flown, sets).figure[0]
    alone, light = evaluate((CLEAR, MARGIN), flown[:1], sets).figure[0]
    assert every < own == alone and margin == light
    table = figures(goals, flown, sets)
    assert np.isfinite(table["delay_margin_s"][0]).tolist() == [True, *[False] * 8]
    assert monte_carlo(figures, goals[1:2], flown[1:], {"k_v": 2.0, "k1": 0.3}).missed == {}


def test_the_worst_run_of_a_refuted_goal_is_the_counterexample(monkeypatch):
    install(monkeypatch, Loop(mass=0.2))
    flown = fresh([case("tank-static", "sur540-flooded")], runs=200, first=0)
    found = monte_carlo(figures, (CLEAR, THRIFT), flown, {"k1": 0.4, "k_v": 1.5})
    worst, *next_to_it = found.counterexamples
    assert len(next_to_it) == 2 and worst.figure < next_to_it[0].figure < next_to_it[1].figure < CLEAR.limit
    assert all(c.normalised > 1 for c in found.counterexamples)
    assert found.refuted == ("keep clear",)
    assert worst.goal == "keep clear" and found.normalised["spare thrust"] <= 1 and 0 < found.missed["keep clear"] < 1
    again = monte_carlo(figures, (CLEAR,), [worst.condition([flown[0].case])], {"k1": 0.4, "k_v": 1.5})
    assert again.normalised["keep clear"] == worst.normalised == found.normalised["keep clear"]


def test_what_refutes_a_mean_has_about_its_mean(monkeypatch):
    install(monkeypatch, Loop(mass=0.2))
    cases = [case("tank-static", "sur540-flooded"), case()]
    mean = Goal("mean thrust", "effort_n", "N", 0.1, over="mean")
    flown = fresh(cases, runs=400, first=0)
    found = monte_carlo(figures, (mean,), flown, {"k1": 0.4, "k_v": 1.5}, each=10).counterexamples
    assert [sum(c.case == one.name for c in found) for one in cases] == [10, 10]
    figure = figures((mean,), flown, {"k1": np.array([0.4]), "k_v": np.array([1.5])})["effort_n"][0]
    assert np.mean([c.figure for c in found]) == pytest.approx(figure.mean(), abs=0.1 * figure.std())


def test_counterexamples_become_constraints_until_nothing_is_refuted(monkeypatch):
    install(monkeypatch, Loop(mass=0.05))
    tuning = tune(heavy(), trials=32, rounds=6, runs=300)
    assert tuning.rounds[0].training, "the first search leans on the nominal plant"
    assert tuning.accepted and not tuning.result.refuted and not tuning.conflict
    assert all(tuning.better[1:]), "what is left is not the start gains"
    assert len(tuning.request.conditions) > tuning.requested
    seeds = [s for r in tuning.rounds for s in range(r.verified.seeds[0], r.verified.seeds[1] + 1)]
    assert len(set(seeds)) == len(seeds) and not set(seeds) & {
        c.seed for c in tuning.request.conditions[: tuning.requested]
    }
    hit = tuning.rounds[0].training[0]
    assert abs(hit.plant["plant.m11"] / 95 - 1) > 0.3, "the worst run has a mass far off"


def test_a_conflict_is_named_and_is_minimal(monkeypatch):
    install(monkeypatch)
    near = Goal("stay very near", "deviation_m", "m", 0.13, kind="hard")
    idle = Goal("idle", "time_s", "s", 1000.0, kind="hard")
    asked, told = request(goals=(idle, CLEAR, near, THRIFT), k1=(0.13, 3.0), k_v=(0.5, 4.0)), []
    tuning = tune(asked, trials=32, runs=0, progress=told.append)
    assert not tuning.accepted and len(tuning.rounds) == 2
    assert "32 trials of the same request are resumed" in told, "nothing is feasible: the search goes on, once"
    assert tuning.conflict == ("keep clear", "stay very near")


def test_a_missed_goal_names_its_run_and_the_advice_follows_the_cause(monkeypatch):
    install(monkeypatch, Loop(mass=0.2))
    far = replace(CLEAR, limit=0.2)
    told = []
    tuning = tune(heavy(goals=(far, NEAR)), trials=32, rounds=1, runs=0, progress=told.append)
    [miss] = misses(tuning)
    assert miss.figure == tuning.tuned.evaluation.figure[0, 0] and miss.run == tuning.request.conditions[0]
    assert "keep clear in tank-static/sur540-flooded/truth, seed 0: min_clearance_m 0.0" in miss.text
    assert miss.text.endswith(" s), bound ≥ 0.2 m; missed in 1 of 1 run") and "(reached at " in miss.text
    assert advice(tuning, trials=32)[1] is False and "keep clear even without" in advice(tuning, trials=32)[0]
    assert advice(replace(tuning, conflict=()), trials=32)[1] is True
    assert not any("score" in line for line in told)
    lost = [line for line in told if "trial 32/32" in line]
    assert lost and all("fewest violated: 1 of 1 (keep clear)" in line for line in lost)
    start = tuning.hand.evaluation
    wild = np.full_like(start.normalised, np.inf)
    none = replace(tuning.hand, evaluation=replace(start, normalised=wild, figure=np.full_like(wild, np.nan)))
    table = summary(replace(tuning, hand=none))[:3]
    assert "> 100 →" in table[1] and "no arrival" in table[1] and not any("inf" in row or "nan" in row for row in table)


def test_a_refuted_goal_names_the_verifying_run(monkeypatch):
    install(monkeypatch, Loop(mass=0.2))
    tuning = tune(heavy(goals=(CLEAR, THRIFT)), trials=32, rounds=1, runs=50)
    verified = tuning.result.verified
    fresh = replace(tuning.result, verified=replace(verified, missed={"keep clear": 0.06}, counterexamples=(
        Counterexample("keep clear", tuning.request.cases[0].name, 77, {"plant.m11": 90.0}, 0.031, 1.6),
    )))  # fmt: skip
    good = replace(tuning.tuned, evaluation=replace(tuning.tuned.evaluation, normalised=np.array([[0.9, 0.9]])))
    light = tuple(c for c in tuning.request.conditions if c.goals is None)
    easy = tuple(replace(g, limit=0.001) if g.name == "keep clear" else g for g in tuning.request.goals)
    request = replace(tuning.request, goals=easy, conditions=light)
    refuted = replace(tuning, rounds=(fresh,), tuned=good, request=request)
    [miss] = misses(refuted)
    assert "seed 77, m11 = 90: min_clearance_m 0.031 m" in miss.text
    assert miss.text.endswith("missed in 6.00% of the verifying runs")


def test_the_counterexamples_of_a_case_are_one_demand():
    asked = request()
    run = replace(asked.conditions[0], seed=7, goals=("keep clear",))
    both = replace(run, seed=8, goals=("keep clear", "stay near"))
    found = {d.label: d for d in demands(asked.goals, (*asked.conditions, run, both), ("stay near",))}
    assert list(found) == [
        "keep clear",
        "stay near",
        "keep clear in 2 runs of pool-static/sur400/truth that refuted other gains",
        "stay near in pool-static/sur400/truth, seed 8",
    ]
    for label, seeds in zip(found, ([0, 1], [0, 1], [7, 8], [8]), strict=True):
        demand = found[label]
        assert [c.seed for c in demand.conditions] == seeds and demand.goal.kind == "hard"
        assert {c.goals for c in demand.conditions} == {(demand.goal.name,)}


def test_of_sets_that_miss_a_hard_goal_the_one_is_better_that_misses_it_in_fewer_runs():
    asked = request((CLEAR,), seeds=range(100))
    figure = np.full((4, 100), 0.1)
    figure[1, 7] = np.nan  # one run that does not arrive
    figure[2] = 0.045
    figure[3] = np.nan
    table = {"min_clearance_m": figure, "effort_n": np.ones((4, 100))}
    found = judged(asked.goals, asked.conditions, table)
    constraints = Pool({"k1": np.ones(4)}, found, np.zeros((4, 0))).constraints[:, 0]
    assert found.feasible.tolist() == [True, False, False, False]
    np.testing.assert_allclose(constraints, [-0.5, 0.01, 1 / 9, 1.0])


@given(
    st.integers(1, 40).flatmap(lambda n: st.tuples(st.just(n), st.sets(st.integers(0, n - 1), min_size=1, max_size=6)))
)
def test_a_minimal_subset_is_found_by_few_questions(drawn):
    count, core = drawn
    asked = []

    def together(subset):
        asked.append(subset)
        return not core <= set(subset)

    found = minimal_subset(count, together)
    assert len(asked) <= 2 * len(core) * (1 + np.log2(count / len(core)))
    assert set(found) == core
    assert all(together(part) for part in combinations(found, len(found) - 1) if part)


def test_rounds_resume_without_a_run_of_the_finished_ones(monkeypatch, tmp_path):
    first = install(monkeypatch, Loop(mass=0.05))
    whole = tune(heavy(), trials=32, rounds=6, runs=100, folder=tmp_path)
    again = install(monkeypatch, Loop(mass=0.05))
    resumed = tune(heavy(), trials=32, rounds=6, runs=100, folder=tmp_path)
    assert json.dumps(tuning_dict(resumed)) == json.dumps(tuning_dict(whole))
    assert again.runs < 0.2 * first.runs
    # what other requests left in the folder is not taken for this one's
    install(monkeypatch, Loop(mass=0.05))
    other = tune(heavy(), trials=32, rounds=6, runs=50, folder=tmp_path)
    install(monkeypatch, Loop(mass=0.05))
    assert json.dumps(tuning_dict(other)) == json.dumps(tuning_dict(tune(heavy(), trials=32, rounds=6, runs=50)))
    assert tune(heavy(), trials=32, rounds=6, runs=100, folder=tmp_path).rounds == whole.rounds


def test_the_gain_file_says_where_it_comes_from_and_reads_back(monkeypatch, tmp_path):
    install(monkeypatch)
    odd = replace(CLEAR, name='keep "clear"\n# \\ "" \x7f')
    tuning = tune(request(goals=(odd, NEAR)), trials=32, rounds=1, runs=20)
    gains = tuned_gains(tuning)
    path = tmp_path / "gains.toml"
    path.write_text(write_gains(gains))
    read = load_gains(str(path))
    assert read.values == gains.values and read.provenance == gains.provenance
    for part in ("search seed 0", tuning.request.digest[:16], "seeds 0 to 1", "20 fresh runs", "0.05 m", "round"):
        assert part in read.provenance


def test_claims_that_should_hold_do_for_the_shipped_gains(monkeypatch):
    names = expected_to_hold()
    assert "v1-corrected" in names and len(names) > 5
    monkeypatch.setattr("surctl.marine.tuning.request.expected_to_hold", lambda: ("v1-corrected", "v2-static"))
    assert refuted_claims(GAINS.values, [case()]) == ()
    monkeypatch.setattr("surctl.marine.tuning.request.expected_to_hold", lambda: ("v1-printed", "v2-static"))
    assert [v.claim.name for v in refuted_claims(GAINS.values, [case()], seed=1)] == ["v1-printed"]


def test_claims_about_path_following_do_not_judge_the_gains_of_another_law():
    # a gain of a law of one's own may have the name of a constant of these claims
    named_alike = {**GAINS.values, "radius": 0.0}
    with pytest.raises(InputError, match="radius"):
        refuted_claims(named_alike, [case()])
    own = law_ref("wall.py:wall", folder=Path(__file__).parents[2] / "analysis" / "27_own_law")
    assert refuted_claims(named_alike, [replace(case(), law=own), replace(case(), guidance="ilos")]) == ()


def test_a_refuted_point_of_a_claim_is_a_constraint(monkeypatch):
    install(monkeypatch)
    point = ClaimPoint("v1-printed", {"x_e": 1.5, "y_e": 1.5, "z_e": 0.0, "turn": 0.0}, 0.0)
    sets = {"k1": np.array([0.05, 1.0])}
    found = replace(request(), claims=(point,)).excess(sets)
    assert found.shape == (2, 1) and found[0, 0] <= 0 < found[1, 0]
    pool = replace(request(), claims=(point,)).judge({"k1": np.array([0.13, 1.0]), "k_v": np.array([2.0, 2.0])})
    assert pool.constraints.shape == (2, 2) and not pool.feasible[1]


def test_numbers_that_make_no_sense_are_told():
    for words in ({"trials": 0}, {"rounds": 0}, {"runs": -1}):
        with pytest.raises(InputError, match="must be at least"):
            tune(request(), **words)


def test_a_linear_goal_limits_the_bandwidth(monkeypatch):
    install(monkeypatch)
    pool = search(request(goals=(MARGIN, NEAR), with_corners=True), trials=64)
    best = pool.best(pool.evaluation.normalised[0])
    assert pool.feasible[best] and pool.sets["k_v"][best] <= 3.0

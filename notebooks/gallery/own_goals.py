"""Goals of your own: compare two gain sets with normalised values

Goals are bounds on metrics of the loop and of runs. A normalised value of at most 1 means that the goal is met, as in
Control System Tuner. The hand-chosen gains and a faster set are compared.
"""

from pathlib import Path

from surctl.marine.control import load_gains
from surctl.marine.report import GoalBars, plot_goal_bars
from surctl.marine.simulation import load_scenario
from surctl.marine.tuning import build_cases, conditions, evaluate, load_goals
from surctl.marine.vehicle import load_vehicle

Path("goals.toml").write_text("""
kind = "goals"
name = "calm"
[[goals]]
name = "arrive"
metric = "reached"
at_least = { value = 1, unit = "1" }
kind = "hard"
[[goals]]
name = "bear delay"
metric = "delay_margin_s"
at_least = { value = 0.3, unit = "s" }
kind = "hard"
[[goals]]
name = "soon"
metric = "time_s"
at_most = { value = 20, unit = "s" }
[[goals]]
name = "on the path"
metric = "path_error_m"
at_most = { value = 0.05, unit = "m" }
""")
mission, robot, hand = load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default")
runs = conditions(build_cases([mission], gains=hand, law="closed_form"), seeds=[0])
goals = load_goals("goals.toml")
sets = {"k_v": [hand["k_v"], 4.0], "lookahead": [hand["lookahead"], 0.3]}
result = evaluate(goals, runs, sets)
names = ("default", "fast")
for goal, values in zip(goals, result.normalised.T, strict=True):
    print(f"{goal.name:12} {goal.kind:4}", *(f"{name} {value:.2f}" for name, value in zip(names, values, strict=True)))
bars = GoalBars(
    tuple(goal.name for goal in goals),
    tuple(goal.kind == "hard" for goal in goals),
    *result.normalised,
    result.place[1],
)
ax = plot_goal_bars(bars)
for text, name in zip(ax.get_legend().get_texts(), names, strict=True):
    text.set_text(name)
ax.figure.savefig("own_goals.png")

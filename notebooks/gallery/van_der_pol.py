"""Van der Pol in reversed time: a certificate of a region of attraction

For a stated Lyapunov function, the largest provable level is searched and proved, and an independent program checks the
certificate. Without the line `function`, a function is searched too.
"""

from pathlib import Path

from surctl.certcheck import check_document
from surctl.lyapunov import load_problem, solve
from surctl.report import plot_motion

Path("van-der-pol.toml").write_text("""
kind = "lyapunov"
name = "van-der-pol"
function = "1.5*x^2 - x*y + y^2"
[states]
x = { rate = "-y", lower = -3, upper = 3 }
y = { rate = "x - (1 - x^2)*y", lower = -3.5, upper = 3.5 }
""")
problem = load_problem(Path("van-der-pol.toml"))
solution = solve(problem)
claim = solution.decision.claim
share = claim.level / solution.falsified
print(f"{solution.verdict}: V < {claim.level:.3g}, {share:.1%} of the least level with a counterexample")
checked = check_document(dict(solution.decision.document))
print("checker:", "accepted" if checked.accepted else "rejected", "-", checked.proves)
plot_motion(problem.dynamics, claim.function, level=claim.level, falsified=solution.falsified).savefig(
    "van_der_pol.png"
)

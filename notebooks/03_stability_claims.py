import marimo

__generated_with = "0.25.2"
app = marimo.App(width="medium", app_title="Which stability claims hold")


@app.cell
def _():
    import marimo as mo

    return (mo,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    # Which stability claims hold, and how far

    A stability claim is an inequality over a domain. This notebook first decides claims of your own, about any
    dynamics: an inequality, and a region of attraction. Then it examines claims of the paper and of its robot in the
    same way. An independent program checks the certificate of each proof.
    """)
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 1. An inequality of your own

    Does the drag always brake a hull, and by at least 8 N per m/s? By at least 9? A falsifier samples the domain and
    follows gradients to a violation. A prover rewrites the expression exactly and bisects boxes in interval
    arithmetic. Falsifier and prover work independently of each other.
    """)
    return


@app.cell
def _():
    import tempfile
    from pathlib import Path

    from surctl.certcheck import check_document
    from surctl.marine.verification import claims
    from surctl.verification import decide, load_claim

    def from_text(load, text):
        """Write a file and return what `load` reads from it."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "claim.toml")
            path.write_text(text, encoding="utf-8")
            return load(path)

    for _least in (8, 9):
        _claim = from_text(
            load_claim,
            f"""
    kind = "claim"
    name = "drag-{_least}"
    left = "-(8*u + 2*abs(u)*u)*u"
    right = "-{_least}*u^2"
    unit = "W"
    [variables]
    u = {{ lower = -0.3, upper = 0.3, unit = "m/s", meaning = "surge speed" }}
    """,
        )
        _v = decide(_claim, seed=0)
        if _v.counterexample is None:
            print(f"{_claim.name}: {_v.verdict}, checker: {check_document(_v.certificate).proves}")
        else:
            print(f"{_claim.name}: {_v.verdict} at {dict(_v.counterexample.values)}")
    return check_document, claims, decide, from_text


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 2. A region of attraction of your own dynamics

    From which states does a system return to its equilibrium? The file states the dynamics, Van der Pol's oscillator
    in reversed time, and a Lyapunov function $V$. surctl searches the largest level $c$ for which it can prove that
    $\dot V < 0$ wherever $V < c$, except at the equilibrium. The plot also shows the least level that has a
    counterexample. Without the line `function`, surctl searches $V$ too, which takes about 20 s here. A number under
    `[parameters]` has a range, and the proof holds for all of it.
    """)
    return


@app.cell
def _(check_document, from_text):
    from surctl.lyapunov import load_problem, solve
    from surctl.report import plot_motion

    _problem = from_text(
        load_problem,
        """
    kind = "lyapunov"
    name = "van-der-pol"
    function = "1.5*x^2 - x*y + y^2"
    [states]
    x = { rate = "-y", lower = -3, upper = 3 }
    y = { rate = "x - (1 - x^2)*y", lower = -3.5, upper = 3.5 }
    """,
    )
    _solution = solve(_problem)
    _claim = _solution.decision.claim
    _checked = check_document(dict(_solution.decision.document))
    print(f"van-der-pol: {_solution.verdict}, accepted: {_checked.accepted}")
    print(f"V < {_claim.level:.3g}; least level with a counterexample: {_solution.falsified:.3g}")
    plot_motion(_problem.dynamics, _claim.function, level=_claim.level, falsified=_solution.falsified)
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 3. Claims of the paper, printed and corrected

    With $V_1 = \tfrac12(x_e^2 + y_e^2 + z_e^2)$ and the surge command of (12), the paper concludes $\dot V_1 \le 0$
    everywhere, for the kinematic loop of its robot. The claim `v1-printed` fails only where $x_e > v_d/k_1$. There
    the printed surge command is negative, and a robot that moves backwards along its line of sight is steered *away*
    from the path. The left plot shows a slice of the domain with the region where the claim fails. The right plot
    shows the motion from the counterexample.
    """)
    return


@app.cell
def _(check_document, claims, decide):
    import matplotlib.pyplot as plt

    from surctl.marine.control import load_gains
    from surctl.report import margin_slice, plot_counterexample, plot_slice

    gains = load_gains("default")
    _verdicts = {c.name: decide(c, seed=0) for c in claims(gains.values, ["v1-printed", "v1-corrected"])}
    for _name, _v in _verdicts.items():
        _proof = "" if _v.certificate is None else f", accepted: {check_document(_v.certificate).accepted}"
        print(f"{_name}: {_v.verdict}{_proof}")
    _figure, (_left, _right) = plt.subplots(1, 2, figsize=(10.5, 3.9), layout="constrained")
    plot_slice(margin_slice(_verdicts["v1-printed"]), _left)
    plot_counterexample(_verdicts["v1-printed"], _right)
    _figure
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 4. A region of attraction of the robot

    `surctl verify region-cruise-20` proves from how far beside a straight leg the robot returns with $\dot V \le
    -aV$. The claim includes saturated thrust, and mass and drag off by up to 20 %; waves and thrust errors can act as
    a bounded force (`RegionStatement(force_n=…)`). The proofs about the robot do not cover sensing, curved paths,
    fast obstacles, or different masses in surge and sway. Each certificate lists its own exclusions; the page [what
    is proved](guides/what-is-proved.md) lists all of them.
    """)
    return


if __name__ == "__main__":
    app.run()

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

    A stability claim is an inequality over a domain. This notebook examines claims of the paper. It refutes printed
    claims by counterexamples that can be simulated, and proves their corrections. These claims are about the kinematic
    loop. For the robot with mass, drag and thrust limits, the notebook proves a region of attraction, with a
    certificate that an independent program accepts. It takes about 20 s.
    """)
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 1. Claims of the paper, printed and corrected

    With $V_1 = \tfrac12(x_e^2 + y_e^2 + z_e^2)$ and the surge command of (12), the paper concludes $\dot V_1 \le 0$
    everywhere. A falsifier samples the domain and follows gradients to a violation. A prover rewrites the expression
    exactly and bisects boxes in interval arithmetic. Falsifier and prover work independently of each other.
    """)
    return


@app.cell
def _(mo):
    from surctl.certcheck import check_document
    from surctl.control import load_gains
    from surctl.vehicle import load_vehicle
    from surctl.verification import claims, decide

    gains, vehicle = load_gains("default"), load_vehicle("sur540-flooded")
    names = ["v1-printed", "v1-corrected", "course-printed", "course-corrected", "v2-printed", "v2-static"]
    verdicts = {c.name: decide(c, seed=0) for c in claims(gains.values, names)}
    _rows = ["| claim | equation | verdict | counterexample, or time of the check |", "|---|---|---|---|"]
    for _name, _v in verdicts.items():
        if _v.counterexample is not None:
            _at = ", ".join(f"{k} = {x:.3g}" for k, x in _v.counterexample.values.items())
            _detail = f"{_at}: exceeded by {_v.counterexample.margin:.3g} {_v.claim.unit}"
        else:
            _detail = f"accepted by the checker in {1e3 * check_document(_v.certificate).seconds:.0f} ms"
        _rows.append(f"| `{_name}` | {_v.claim.equation} | {_v.verdict} | {_detail} |")
        print(f"{_name}: {_v.verdict}")
    mo.md("\n".join(_rows))
    return check_document, claims, gains, decide, vehicle, verdicts


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 2. Simulation of a counterexample

    The claim `v1-printed` fails only where $x_e > v_d/k_1$. There the printed surge command is negative, and a robot
    that moves backwards along its line of sight is steered *away* from the path. The left plot shows a slice of the
    domain with the region where the claim fails. The right plot shows the motion from the counterexample.
    """)
    return


@app.cell
def _(plt, verdicts):
    from surctl.report import margin_slice, plot_counterexample, plot_slice

    _figure, (_left, _right) = plt.subplots(1, 2, figsize=(10.5, 3.9), layout="constrained")
    plot_slice(margin_slice(verdicts["v1-printed"]), _left)
    plot_counterexample(verdicts["v1-printed"], _right)
    _figure
    return


@app.cell
def _():
    import matplotlib.pyplot as plt

    return (plt,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    No value of the look-ahead Δ of (9) makes the claim true: change it with the slider, and the claim fails at another
    point.
    """)
    return


@app.cell
def _(mo):
    lookahead = mo.ui.slider(0.3, 2.0, 0.1, value=0.8, label="look-ahead Δ [m]", show_value=True)
    lookahead
    return (lookahead,)


@app.cell
def _(claims, gains, lookahead, mo, decide):
    (_claim,) = claims({**gains.values, "lookahead": lookahead.value}, ["v1-printed"])
    _worst = decide(_claim, seed=0).counterexample
    mo.md(f"Largest violation: {_worst.margin:.3g} {_claim.unit} at y_e = {_worst.values['y_e']:.3g} m.")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 3. A region of attraction of the dynamic loop

    A real robot does not follow its velocity commands immediately. The region claim states from how far beside a
    straight leg the robot returns with $\dot V \le -aV$. It includes mass, drag and saturated thrust, and holds for
    mass and drag off by up to 20 % and for any heading. A search proposes $V = \xi^\top P\xi$, and the checker decides
    in exact arithmetic whether the claim holds.
    """)
    return


@app.cell
def _(check_document, gains, vehicle):
    from surctl.report import plot_region
    from surctl.verification.region import RegionStatement, prove_statement

    region = prove_statement(RegionStatement(name="cruise", share=0.2, rate_per_s=0.05, attempts=20), vehicle, gains)
    print(f"region: {region.verdict}, accepted: {check_document(region.document).accepted}")
    print(region.sentence)
    plot_region(region.document)
    return RegionStatement, prove_statement


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 4. The path error under a disturbance force

    Waves and thrust errors act as a bounded disturbance force that may vary arbitrarily. A larger force gives a larger
    bound on the final path error.
    """)
    return


@app.cell
def _(RegionStatement, gains, mo, prove_statement, vehicle):
    _rows = ["| force [N] | region of attraction: offset [m] | final error along, across [m] |", "|---|---|---|"]
    for _force in (0.0, 0.5):
        _statement = RegionStatement(name="disturbed", force_n=_force, rate_per_s=0.01, attempts=20)
        _proof = prove_statement(_statement, vehicle, gains)
        _rows.append(
            f"| {_force:g} | {_proof.offset:.3f} | {_proof.ultimate_bound[0]:.3f}, {_proof.ultimate_bound[1]:.3f} |"
        )
        print(f"force {_force:g} N: {_proof.verdict}")
    mo.md("\n".join(_rows))
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    These proofs do not cover sensing, curved paths, fast obstacles, or different masses in surge and sway. Each
    certificate lists its own exclusions, and `notebooks/guides/what-is-proved.md` lists all of them.
    """)
    return


if __name__ == "__main__":
    app.run()

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

    A stability claim is an inequality over a domain. This notebook takes the paper's claims one by one: it refutes
    the printed ones by a point that can be flown, proves what holds in their place, and goes on from the kinematic
    loop to the robot with its mass, drag and thrust limits: a region of attraction with a certificate that another
    program accepts. It takes about 20 s.
    """)
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 1. Every claim of the paper, as printed and as it holds

    With $V_1 = \tfrac12(x_e^2 + y_e^2 + z_e^2)$ and the surge command of (12) the paper concludes $\dot V_1 \le 0$
    everywhere. A falsifier samples the domain and climbs; a prover halves boxes, with every rounding outwards, after it
    has rewritten the expression exactly. Neither trusts the other.
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
    _rows = ["| claim | equation | verdict | where it fails, or who accepts it |", "|---|---|---|---|"]
    for _name, _v in verdicts.items():
        if _v.counterexample is not None:
            _at = ", ".join(f"{k} = {x:.3g}" for k, x in _v.counterexample.values.items())
            _told = f"{_at}: exceeded by {_v.counterexample.margin:.3g} {_v.claim.unit}"
        else:
            _told = f"the checker, in {1e3 * check_document(_v.certificate).seconds:.0f} ms"
        _rows.append(f"| `{_name}` | {_v.claim.equation} | {_v.verdict} | {_told} |")
        print(f"{_name}: {_v.verdict}")
    mo.md("\n".join(_rows))
    return check_document, claims, gains, decide, vehicle, verdicts


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 2. A counterexample is a flight

    The claim fails only where $x_e > v_d/k_1$: the printed surge command turns round there, and a robot that flies
    backwards along its line of sight is steered *away* from the path. Left, the slice of the domain where it fails;
    right, the motion from the counterexample.
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
    The look-ahead Δ of (9) does not mend it: move it, and the claim fails elsewhere.
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
    _found = decide(_claim, seed=0).counterexample
    mo.md(f"Worst by {_found.margin:.3g} {_claim.unit} at y_e = {_found.values['y_e']:.3g} m.")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 3. The robot that flies: a region of attraction

    Velocities do not follow their commands at once. With mass, drag and thrust limits the question becomes: from how
    far beside a straight leg does the cruise come back, at a rate $\dot V \le -aV$, whatever the true mass and drag
    within 20 %, whatever the heading does, with saturated thrust? The search proposes $V = \xi^\top P\xi$; the checker
    decides, in exact arithmetic.
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
    ## 4. How close it settles when something pushes

    Waves and thrust errors are a force that changes as it likes. More force, a wider floor: the gain from force to
    offset.
    """)
    return


@app.cell
def _(RegionStatement, gains, mo, prove_statement, vehicle):
    _rows = ["| force [N] | from [m] | settles along, across [m] |", "|---|---|---|"]
    for _force in (0.0, 0.25, 0.5):
        _statement = RegionStatement(name="pushed", force_n=_force, rate_per_s=0.01, attempts=20)
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
    What none of this covers: sensing, curved paths, obstacles that move fast, and surge and sway of different mass.
    Each certificate names its own exclusions, and `notebooks/guides/what-is-proved.md` lists them all.
    """)
    return


if __name__ == "__main__":
    app.run()

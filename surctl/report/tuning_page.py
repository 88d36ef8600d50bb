# /// script
# [tool.marimo.display]
# theme = "system"
# ///
"""The tuning page, a marimo app that `surctl tune --page` serves; the module `bench` computes its contents."""

import marimo

app = marimo.App(width="full", app_title="surctl: tune")


@app.cell
def _():
    import marimo as mo

    from surctl.control import load_gains
    from surctl.errors import SurctlError
    from surctl.report import page_parts as parts
    from surctl.report.bench import save_gains, slider_steps
    from surctl.report.serve import current_bench
    from surctl.verification import speeds_text
    from surctl.verification.loops import LOOP_NAMES

    bench = current_bench()
    return LOOP_NAMES, SurctlError, bench, load_gains, mo, parts, save_gains, slider_steps, speeds_text


@app.cell
def _(bench, mo, parts):
    get_base, set_base = mo.state(bench.gains)
    get_message, set_message = mo.state("")
    mo.Html(parts.head(bench))
    return get_base, get_message, set_base, set_message


@app.cell
def _(bench, get_base, mo, slider_steps):
    base = get_base()
    sliders = mo.ui.dictionary(
        {
            r.name: mo.ui.slider(
                steps=slider_steps(r, base[r.name]),
                value=base[r.name],
                debounce=True,
                show_value=True,
                full_width=True,
                label=f"{r.name} [{base.specs[r.name].unit}]: {base.specs[r.name].meaning}",
            )
            for r in bench.ranges(base)
        }
    )
    return base, sliders


@app.cell
def _(SurctlError, base, load_gains, mo, save_gains, set_base, set_message, sliders):
    name_box = mo.ui.text(value="gains.toml", label="gain file", full_width=True)

    def _load(_):
        try:
            set_base(load_gains(name_box.value, own=base.own))
            set_message(f"loaded {name_box.value}")
        except SurctlError as error:
            set_message(f"error: {error}")

    def _save(_):
        try:
            tuned = base.with_values(sliders.value, provenance=f"tuning page, from {base.name}: {base.provenance}")
            set_message(f"saved {save_gains(tuned, name_box.value)}")
        except SurctlError as error:
            set_message(f"error: {error}")

    save_button = mo.ui.button(label="Save", on_click=_save)
    load_button = mo.ui.button(label="Load", on_click=_load)
    return load_button, name_box, save_button


@app.cell
def _(base, bench, sliders):
    gains = base.with_values(sliders.value)
    run = bench.simulate(gains)
    linear = bench.linear(gains)
    return gains, linear, run


@app.cell
def _(LOOP_NAMES, bench, gains, mo):
    verdict_button = mo.ui.run_button(label="Check the claims for these gains")
    locus_gain = mo.ui.dropdown(list(bench.locus_gains), value=bench.locus_gains[0], label="locus over")
    _all = f"all, at {bench.scenario.cruise:g} m/s"
    _shown = {_all: None, **{name: name for name in LOOP_NAMES}}
    # the loop that the speed changes most: its gain is the speed over the lookahead
    loop_box = mo.ui.dropdown(_shown, value="cross_track" if len(bench.speeds) > 1 else _all, label="loop")
    _ = gains
    return locus_gain, loop_box, verdict_button


@app.cell
def _(get_message, load_button, mo, name_box, parts, save_button, sliders, verdict_button):
    mo.vstack(
        [
            mo.Html(parts.sliders(sliders.elements.values())),
            name_box,
            mo.hstack([save_button, load_button, verdict_button], justify="start", wrap=True),
            mo.Html(parts.message(get_message())),
        ]
    )
    return


@app.cell
def _(bench, gains, linear, mo, parts, run):
    _figures = parts.figures(run, linear)
    _judged = parts.goals(bench.judge(gains))
    _by_speed = parts.speeds(bench.over_speeds(gains, parts.BY_SPEED))
    mo.Html(parts.pair(_figures, _judged) + _by_speed + parts.picture(bench.plan(run).figure, parts.run_text(run)))
    return


@app.cell
def _(bench, gains, loop_box, mo, parts, speeds_text):
    _speeds = speeds_text(bench.speeds)
    _steps = f"Step responses of surge speed, heading and cross-track at {_speeds}"
    _left = parts.attempt(lambda: parts.picture(bench.steps(gains), _steps))
    _which = "the eight loops" if loop_box.value is None else f"loop {loop_box.value} at {_speeds}"
    _right = parts.attempt(lambda: parts.picture(bench.bode(gains, loop_box.value), f"Bode plot of {_which}"))
    _what = f"Sensitivity S and complementary sensitivity T of all loops together at {_speeds}"
    _below = parts.attempt(lambda: parts.picture(bench.sensitivity(gains), _what))
    mo.vstack([loop_box, mo.Html(parts.pair(_left, _right) + _below)])
    return


@app.cell
def _(bench, gains, locus_gain, mo, parts):
    _what = f"Closed-loop poles over {locus_gain.value}"
    _locus = parts.attempt(lambda: parts.picture(bench.locus(gains, locus_gain.value).figure, _what))
    mo.vstack([locus_gain, mo.Html(_locus)])
    return


@app.cell
def _(bench, gains, mo, parts, verdict_button):
    mo.Html(parts.attempt(lambda: parts.verdicts(bench.verdicts(gains) if verdict_button.value else None)))
    return


if __name__ == "__main__":
    app.run()

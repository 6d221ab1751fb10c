"""`bowden verify`: the closed loop without and with compensation of a diagnosis's effects."""

from pathlib import Path
from typing import Annotated, Any

import typer

from bowden import output_files
from bowden.cli import ending, options, terminal
from bowden.cli.app import app
from bowden.cli.option_groups import Bus, SimulatedOptions, WalkOptions
from bowden.cli.terminal import CommandAnswer

Model = Annotated[Path, typer.Argument(
    metavar="EXTENDED", help="extended.toml of bowden diagnose -o.", show_default=False)]
Output = Annotated[Path, typer.Option(
    "-o", "--output", metavar="FILE", help="Trials to write: FILE with -before and -after before its suffix.")]

FIGURES = (
    ("relative RMSE (%)", "relative_rmse_percent"), ("  within 10…30 % of gait (%)", "relative_rmse_window_percent"),
    ("largest at idle (N)", "max_idle_tension_n"), ("jump at the peak (N)", "peak_jump_n"),
)


@app.command()
def verify(
    model: Model, output: Output, walk: WalkOptions, rate: options.Rate = None, calibration: options.Calibration = None,
    *, simulated: SimulatedOptions, reached: Bus, overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Measure what compensation of named effects gains in the control loop.

    One experiment twice on a bench, without and with compensation of the effects in EXTENDED.

    The controller is the extended one unless another is named.

    Example: bowden verify extended.toml --plant-model bench.toml --cycles 4 -o verify.mcap
    """
    from bowden.trials import session

    sections = reached.sections(rate)
    reference, sections["gait"], _ = session.reference(
        walk.gait(sections["gait"], controller="extended"), None, None, period_given=walk.period is not None,
        peak_given=walk.peak is not None)
    chosen = reached.chosen(simulated)
    files = {name: output.with_name(f"{output.stem}-{name}{output.suffix}") for name in ("before", "after")}
    output_files.refuse_ending(output, ".mcap", what="a trial")
    output_files.refuse(files.values(), overwrite=overwrite, inputs=[
        model, calibration, reached.config, simulated.plant_model])
    prepared = {
        name: session.prepare(sections, reference, calibration, chosen, dry_run=False,
                              controller_model=model if name == "after" else None) for name in files}
    progress = terminal.Terminal()
    figures = {name: session.perform(prepared[name], path, overwrite=overwrite, progress=progress,
                                     announce="" if terminal.quiet() else f"{name}, bench on {chosen.told}.")
               for name, path in files.items()}
    result = _compared(model, prepared["after"].experiment, figures)
    return CommandAnswer(result, lambda: _tell(result, figures),
                  max(ending.status_of(one["outcome"], one["stop_reason"]) for one in figures.values()))


def _compared(model: Path, extended: Any, figures: dict[str, dict[str, Any]]) -> dict[str, Any]:
    from bowden.trials.experiment import gained

    judged, gain = gained(figures["before"], figures["after"])
    return {"controller_model": str(model), "effects": {name: dict(values) for name, values in extended.known.items()},
            "terms": [term.equation for term in extended.terms],
            "judged_by": judged, "gain_percent": gain, **figures}


def _tell(result: dict[str, Any], figures: dict[str, dict[str, Any]]) -> None:
    figure, true = terminal.number, result["judged_by"].startswith("true_")
    changes = ", ".join([*result["effects"], *result["terms"]]) or "no effect"
    terminal.table(
        f"{changes}: END {'true' if true else 'by its sensor'}, controller {figures['after']['controller']}",
        ("END", "uncompensated", "compensated"), [
            (text, *(figure(figures[name][f"true_{key}" if true else key]) for name in ("before", "after")))
            for text, key in FIGURES])
    print(f"Gain in relative RMSE: {figure(result['gain_percent'], 1)} %")
    for name, one in figures.items():
        print(f"Trial {name}: {one['trial']}" + (f", stopped: {one['stop_reason']}" if one["stop_reason"] else ""))

"""`bowden plan`, `discover`, `mend`: what follows a diagnosis that names no single effect."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from bowden.cli import ending, options, terminal
from bowden.cli.app import NothingGivenError, app
from bowden.cli.options import BusConfigured, SimulatedOptions, argument, new_file, option
from bowden.cli.terminal import AnswerTable, CommandAnswer, Paragraph, Words
from bowden.deferred import on_first_use
from parameters import InputError
from parameters.files import write_whole

with on_first_use():
    from bowden.mending import supervisor
    from bowden.models import diagnosing, experiment_plan, logbook_entries
    from bowden.pages import model_pictures
    from diagnosis.report.headline import law_sentences
    from physics.effects import own_effects
    from trial.report.words import words


@app.command("plan", example="bowden plan trial.mcap --healthy good.mcap")
def plan_experiment(
    trials: Annotated[list[Path] | None, argument(
        "TRIAL…", "Trials of one session: a gait, and experiments that were run.")] = None,
    healthy: options.Healthy = None,
    logbook: Annotated[Path | None, option(
        "Logbook: its newest ambiguous verdict; with TRIAL, its reference trials.", "DIR")] = None,
    model: Annotated[Path | None, option("Bench model with effects, TOML: that bench is simulated.", "FILE")] = None,
    path: options.ForcePath = None,
) -> CommandAnswer:
    """Find the shortest experiment that separates the effects of an ambiguity set.

    Predicted by simulating this bench under the motion of each experiment of the catalogue.
    """
    if model is not None and (trials or healthy or logbook or path):
        raise InputError("--model simulates its bench; leave trials, --healthy, --logbook and --path out.")
    if model is None and logbook is None and not trials:
        raise NothingGivenError("TRIAL… | --logbook DIR | --model FILE",
                                "name a TRIAL, and with --healthy its reference trials; or a --logbook or a --model.")
    with terminal.waiting("simulating the experiments"):
        if model is not None:
            found = experiment_plan.of_model(model)
        elif trials:
            references, deviations = logbook_entries.reference_trials(logbook, healthy, trials)
            found = experiment_plan.of_trials(trials, references, deviations, logbook_entries.path_of(logbook, path))
        else:
            assert logbook is not None
            found = experiment_plan.of_logbook(logbook)
    good = str(healthy[-1]) if healthy else "a reference trial"
    return CommandAnswer(found.as_json(), _words(found, good))


def _words(found: experiment_plan.ExperimentPlan, good: str) -> Words:
    if len(found.among) < 2:
        yield f"Verdict: {found.verdict}. There is nothing to decide between."
        return
    yield f"Not separated: {', '.join(found.among)}."
    if found.tried:
        yield f"Run already, and did not decide: {', '.join(found.tried)}."
    yield AnswerTable("experiments that the bench runs by itself", (
        "experiment", "s", "decides (%)", "with its reference (%)", "least nats"), [
        (one.name, one.seconds, 100.0 * one.sure, 100.0 * one.with_reference, one.nats)
        for one in found.experiments], ".0f")
    yield from found.advice(good)


@app.command(example="bowden discover trial.mcap --healthy good.mcap -o extended.toml --picture law.png")
def discover(
    trials: Annotated[list[Path] | None, argument("TRIAL…", "Trials of one session, MCAP or CSV.")] = None,
    healthy: options.Healthy = None, path: options.ForcePath = None, lowpass: options.Lowpass = None,
    output: Annotated[Path | None, new_file(
        "extended.toml with the terms, for --plant-model and --controller-model.", "a law", ".toml")] = None,
    picture: Annotated[Path | None, new_file(
        "Residual against the variable of each term, PNG, SVG or PDF.", "a picture", ".png", ".svg", ".pdf",
        name="--picture")] = None,
    promote: Annotated[Path | None, new_file(
        "The terms as effects of your own, TOML, for bowden diagnose --effects.", "an effect", ".toml",
        name="--promote")] = None,
) -> CommandAnswer:
    """Find terms that extend the model where no effect of the catalogue fits.

    At most three terms: constants of the bench that change with load, motion, angle or time.
    """
    if not trials or not healthy:
        raise NothingGivenError("TRIAL… --healthy TRIAL",
                                "give a trial, and with --healthy one in the reference condition.")
    with terminal.fitting("fitting the reference trials, then the terms"):
        found = diagnosing.discover(trials, healthy, lowpass_hz=lowpass, path=path)
    written = []
    if found.terms:  # without a law nothing is written
        written = [path for path in (output, picture, promote) if path is not None]
        if output is not None:
            write_whole(output, found.model.text(), overwrite=True)
        if picture is not None:
            model_pictures.draw_law(found.laws, picture)
        if promote is not None:
            write_whole(promote, own_effects.promoted(found.terms), overwrite=True)
    return CommandAnswer(found.as_json(), [
        *map(Paragraph, law_sentences(found.laws)),
        AnswerTable("RMS error on cycles that no fit has seen", ("signal", "unit", "reference", "session", "law"), [
            (name, f.unit, f.rmse_before, f.rmse_session, f.rmse_after) for name, f in found.errors.items()], ".4f"),
        *(f"Wrote {path}." for path in written)])


@app.command(example="bowden mend --reference good.mcap --plant-model bench.toml -o night")
def mend(
    output: Annotated[Path, option(
        "Folder for trials, journal, extended.toml and mend.html.", "DIR", "-o", "--output")],
    reference: Annotated[list[Path] | None, option(
        "Trials of the bench in the reference condition, of bowden trial.", "TRIAL...")] = None,
    hours: Annotated[float, option("Bench time after which no trial begins.", "HOURS", min=0.0)] = 1.0,
    cycles: Annotated[int, option("Gait cycles of each trial.", "COUNT", min=4)] = 10,
    resume: Annotated[bool, option("Go on with the journal in the folder.")] = False,
    *, simulated: SimulatedOptions, reached: BusConfigured,
) -> CommandAnswer:
    """Repair the model of a bench unattended.

    Records a gait, diagnoses it, runs the experiments that decide, extends the model, and keeps what gains in the loop.
    """
    if not reference:
        raise NothingGivenError("--reference TRIAL -o DIR",
                                "give a trial of the bench in the reference condition.")
    found = supervisor.mend(
        reference, output, bus=reached.chosen(simulated), hours=hours, cycles=cycles, configuration=reached.config,
        bitrate=reached.bitrate, resume=resume, progress=terminal.TERMINAL)
    stopped = "stopped" in found.ending or "time is up" in found.ending
    return CommandAnswer(found.as_json(), [
        *(Paragraph(f"Law: {equation}.") for equation in found.equations),
        f"Named: {', '.join(map(words, found.names))}." if found.names else "",
        "" if found.gain is None else
        f"END's error falls by {found.gain:.3g} points of the peak ({found.scatter}).",
        f"{found.ending[:1].upper()}{found.ending[1:]}.", f"Page: {found.folder / 'mend.html'}"],
        ending.CTRL_C if found.ending.startswith("interrupted") else int(stopped))

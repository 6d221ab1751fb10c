"""`bowden plan`: the experiment that decides between effects which the trials so far do not separate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.command import NothingGivenError
from bowden.cli.terminal import CommandAnswer
from parameters import InputError

if TYPE_CHECKING:
    from bowden.models.experiment_plan import ExperimentPlan

Trials = Annotated[list[Path] | None, typer.Argument(
    metavar="TRIAL…", help="Trials of one session: a gait, and experiments that were run.", show_default=False)]
Book = Annotated[Path | None, typer.Option(
    metavar="DIR", help="Logbook: its newest ambiguous verdict; with TRIAL, its reference trials.")]
Model = Annotated[Path | None, typer.Option(
    metavar="FILE", help="Bench model with effects, TOML: that bench is simulated.")]


@app.command("plan")
def plan_experiment(trials: Trials = None, healthy: options.Healthy = None, logbook: Book = None, model: Model = None,
                    path: options.ForcePath = None) -> CommandAnswer:
    """Find the shortest experiment that separates the effects of an ambiguity set.

    Predicted by simulating this bench under the motion of each experiment of the catalogue.

    Example: bowden plan trial.mcap --healthy good.mcap
    """
    from bowden.models import experiment_plan, logbook_entries

    if model is not None and (trials or healthy or logbook or path):
        raise InputError("--model simulates its bench; leave trials, --healthy, --logbook and --path out.")
    if model is None and logbook is None and not trials:
        raise NothingGivenError("TRIAL… | --logbook DIR | --model FILE",
                                "bowden plan: give trials with --healthy, a --logbook or a --model.")
    with terminal.waiting("simulating the experiments"):
        if model is not None:
            found = experiment_plan.of_model(model)
        elif trials:
            known, deviations = logbook_entries.reference_trials(logbook, healthy) if logbook else (healthy or [], None)
            same = {path.resolve() for path in trials}
            path = path or (logbook_entries.path_of(logbook) if logbook else None)
            references = [p for p in known if p.resolve() not in same]
            found = experiment_plan.of_trials(trials, references, deviations, path)
        else:
            assert logbook is not None
            found = experiment_plan.of_logbook(logbook)
    return CommandAnswer(found.as_json(), lambda: _tell(found, str(healthy[-1]) if healthy else "a reference trial"))


def _tell(found: ExperimentPlan, good: str) -> None:
    if len(found.among) < 2:
        print(f"Verdict: {found.verdict}. There is nothing to decide between.")
        return
    print(f"Not separated: {', '.join(found.among)}.")
    if found.tried:
        print(f"Run already, and did not decide: {', '.join(found.tried)}.")
    terminal.table("experiments that the bench runs by itself", (
        "experiment", "s", "decides (%)", "with its reference (%)", "least nats"), [
        (one.name, f"{one.seconds:.0f}", f"{100.0 * one.sure:.0f}", f"{100.0 * one.with_reference:.0f}",
         f"{one.nats:.0f}") for one in found.experiments])
    proposed = found.proposed
    if proposed is None:
        print("None of them is likely to decide.")
        for name, words in found.by_hand.items():
            print(f"By hand: {name}: {words}.")
        return
    if proposed.name == "repeat":
        print(f"Run: bowden trial --motion-of {good} -o repeat.mcap, then diagnose it alone, with the same "
              "--healthy.")
        return
    if proposed.sure < proposed.with_reference:
        print(f"First, with nothing wrong: bowden trial --experiment {proposed.name} -o {proposed.name}_good.mcap; "
              "give it with --healthy.")
    print(f"Run: bowden trial --experiment {proposed.name} -o {proposed.name}.mcap, then diagnose it beside the trial.")

"""`bowden diagnose`: causes of the simulation's errors on measured trials, and the simulated result of an experiment.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from bowden.cli import options, terminal
from bowden.cli.app import NothingGivenError, app
from bowden.cli.options import argument, new_file, option, refuse_given
from bowden.cli.terminal import AnswerTable, CommandAnswer, Paragraph, Words
from bowden.deferred import on_first_use
from bowden.trials import force_paths
from parameters import InputError
from parameters.files import write_whole

with on_first_use():
    from bowden import workers as job_workers
    from bowden.models import diagnose_each, diagnosing, experiment_plan, logbook_entries
    from diagnosis.findings import Findings
    from diagnosis.report import figure_export, headline
    from trial.report.words import quantities, words


@app.command(example="bowden diagnose trial.mcap --healthy good.mcap -o extended.toml --report diagnosis.html")
def diagnose(
    trials: Annotated[list[Path] | None, argument("TRIAL…", "MCAP, or CSV (.gz) with canonical headers.")] = None,
    calibration: options.Calibration = None, healthy: options.Healthy = None,
    holdout: Annotated[list[Path] | None, option("Trials that are never fitted, only judged.", "TRIAL...")] = None,
    path: options.ForcePath = None, lowpass: options.Lowpass = None,
    output: Annotated[Path | None, new_file(
        "extended.toml: named effects, for --plant-model and --controller-model.", "what was found", ".toml")] = None,
    report: Annotated[Path | None, new_file(
        "One HTML page that needs no network.", *options.PAGE, name="--report")] = None,
    figures: Annotated[Path | None, option("Folder for pictures (PNG) and tables (CSV).", "DIR")] = None,
    terms: Annotated[bool, option(
        "If effects do not explain the whole trial, search terms, too, as bowden discover.")] = False,
    effects: Annotated[list[Path] | None, option(
        "Effects of your own, TOML, beside those of the catalogue; repeatable.", "FILE")] = None,
    tracked: Annotated[tuple[Path, Path] | None, option(
        "With --report: the two trials of bowden verify, shown in it.", "BEFORE AFTER")] = None,
    each: Annotated[bool, option("Diagnose each TRIAL separately, several at a time.")] = False,
    workers: Annotated[int | None, option("With --each: processes (default: one a processor).", "COUNT", min=1)] = None,
    scheduler: Annotated[str | None, option("With --each: Dask scheduler to run on, host:port.", "ADDRESS")] = None,
    logbook: Annotated[Path | None, option("Logbook to enter the verdict in; it replaces --healthy.", "DIR")] = None,
    plan: Annotated[str | None, option(
        "Without a trial: smallest size of each effect that gait, or an experiment of bowden trial --experiment, would "
        "show.", "EXPERIMENT", autocompletion=options.experiments)] = None,
    peak: options.Peak = None, period: options.Period = None, cycles: options.Cycles = None,
    noise: Annotated[float | None, option("With --plan: noise of both tension sensors, 1σ.", "N")] = None,
    overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Name the causes of the simulation's errors.

    From measured trials: the cause by name, with intervals, on held-out data.
    """
    written = {"--logbook": logbook, "-o": output, "--report": report, "--figures": figures, "--terms": terms,
               "--effects": effects, "--tracked": tracked, "--path": path}
    of_each = {"--workers": workers, "--scheduler": scheduler}
    if plan is not None:
        refuse_given({"TRIAL": trials, "--lowpass": lowpass, "--holdout": holdout, "--each": each, **of_each,
                      **written}, "--plan is before any trial; leave {} out.")
        return _plan(plan, (peak, period, cycles, noise), calibration, healthy or [])
    refuse_given({"--peak": peak, "--period": period, "--cycles": cycles, "--noise": noise},
                 "{} belongs to --plan; leave it out, or name an experiment with --plan.")
    if not trials:
        raise NothingGivenError("TRIAL... | --plan EXPERIMENT",
                                "diagnose: no trial given; name at least one, or an experiment with --plan.")
    if each:
        refuse_given(written, "--each gives a verdict for every trial and writes none; leave {} out.")
        return _each(trials, calibration, healthy or [], holdout or [], lowpass, (scheduler, workers))
    refuse_given(of_each, "{} belongs to --each; leave it out, or diagnose every trial for itself.")
    if tracked and not report:
        raise InputError("--tracked is shown in the report; name one with --report.")
    if figures is not None:
        figure_export.refuse(figures, overwrite=overwrite)
    references, deviations = logbook_entries.reference_trials(logbook, healthy, trials if logbook else ())
    path = logbook_entries.path_of(logbook, path)
    if path is not None and calibration is not None:
        calibration = force_paths.file_of(calibration, path)
    with terminal.fitting("diagnosing") as show:
        finder = diagnosing.Diagnosis(
            calibration, lowpass_hz=lowpass, path=path, effects=effects or (), session_sd=deviations, show=show)
        found = finder.fit(references).diagnose(trials, holdout or (), terms=terms)
        show("writing")
        if found.verdict != "refused":
            if output is not None:
                write_whole(output, found.text(), overwrite=True)
            if report is not None:
                found.report(report, tracked=tracked, overwrite=True)
            if figures is not None:
                figure_export.write(found.found, figures, overwrite=overwrite)
    result = found.as_json() | ({} if path is None else {"path": path}) | {"seconds": found.seconds}
    if logbook is not None and found.verdict != "refused":
        for trial in trials:
            logbook_entries.add_verdict(logbook, trial, result)
    return CommandAnswer(result, _words(found.found, path), 2 if found.verdict == "refused" else 0)


def _each(
    trials: list[Path], calibration: Path | None, healthy: list[Path], holdout: list[Path], lowpass: float | None,
    where: tuple[str | None, int | None],
) -> CommandAnswer:
    """Diagnose every trial for itself; status 0 with a result for each, 1 if some were refused, 2 if all were."""
    reference = diagnose_each.ReferenceCondition(calibration, tuple(healthy), lowpass)
    with job_workers.workers_of(*where) as crew, terminal.progress("diagnosing") as update:
        found = diagnose_each.diagnose_each(trials, holdout, reference, crew, update)
    refused = sum(one["verdict"] == "refused" for one in found.values())
    return CommandAnswer({"trials": found}, _words_each(found, lowpass),
                         2 if refused == len(found) else 1 if refused else 0)


def _words_each(found: dict[str, Any], lowpass: float | None) -> Words:
    if lowpass:
        yield f"Every signal low-passed at {lowpass:g} Hz, without phase."
    for trial, one in found.items():
        yield f"{trial}: {one['verdict']}"
        for cause in one["causes"]:
            yield Paragraph(f"{words(cause['effect'])}: {_parameters(cause['parameters'])}", "    ")
        if one.get("candidates"):
            yield Paragraph(
                "no cause named: it ran on the packaged nominal calibration; run bowden identify first", "    ")
        if len(one["class"]) > len(one["causes"]):
            yield Paragraph(f"cannot be told apart: {', '.join(map(words, one['class']))}", "    ")
        if one["verdict"] == "refused":
            yield Paragraph(f"why not: {one['warnings'][0]}", "    ")
        elif one["experiment"]:
            yield Paragraph(f"next: {one['experiment']}", "    ")


def _words(found: Findings, path: str | None) -> Words:
    if path is not None:
        yield f"Path {path}."
    yield from map(Paragraph, headline.headline(found))
    if not found.candidates:
        yield f"\nVerdict: {found.verdict}" + (f" (low-pass {found.lowpass_hz:g} Hz)" if found.lowpass_hz else "")
    yield from _words_of_signals(found.as_json()["relations"])
    shifts = (found.evidence or {}).get("shifts", {})
    if shifts and found.reference == "healthy" and found.bench is None:
        shown = {name: quantities([one[key] for key in ("from", "to", "low", "high")], one["unit"])
                 for name, one in shifts.items()}
        yield AnswerTable("constants of the rig, named or not", ("constant", "unit", "reference", "here", "95 %"), [
            (words(name), unit, reference, here, f"{low} … {high}")
            for name, ((reference, here, low, high), unit) in shown.items()])
    in_headline = int(found.verdict == "refused" and not found.candidates)  # its first warning is the reason
    for warning in found.warnings[in_headline:]:
        yield Paragraph(f"Warning: {warning}")


def _words_of_signals(signals: dict[str, Any]) -> Words:
    """Yield the error of each signal, RMS; names are never cut at 80 columns."""
    if not signals:
        return
    yield AnswerTable("what is left of each signal (RMS, on cycles that the fit has not seen)", (
        "signal", "unit", "floor", "reference", "session", "named", "gain (%)"), [
        (name, row["unit"], *(row[key] for key in ("floor", "rmse_before", "rmse_session", "rmse_after")),
         terminal.number(row["gain_percent"], ".1f")) for name, row in signals.items()], ".4f")
    yield Paragraph(
        "floor: what reference trials miss of each other; reference: the reference condition's model; session: with "
        "this session's constants adapted; named: with the named effects, too; gain: of named over session.")
    held = {name: row for name, row in signals.items() if row["holdout_before"] is not None}
    if held:
        yield AnswerTable("on the trials held out, to which nothing was fitted", (
            "signal", "unit", "reference", "session", "named"), [
            (name, row["unit"], *(row[f"holdout_{which}"] for which in ("before", "session", "after")))
            for name, row in held.items()], ".4f")


def _parameters(parameters: dict[str, Any]) -> str:
    return ", ".join(f"{words(name)} {value['value']:.4g} [{value['low']:.4g}, {value['high']:.4g}] {value['unit']}"
                     for name, value in parameters.items())


def _plan(name: str, walk: tuple[Any, ...], calibration: Path | None, healthy: list[Path]) -> CommandAnswer:
    with terminal.waiting(f"simulating {name}"):
        found = experiment_plan.plan(name, experiment_plan.WalkPlan(*walk), calibration, healthy)
    return CommandAnswer({"experiment": name, **found.as_json()}, [
        AnswerTable(f"the smallest departure from healthy that {name} shows", (
            "effect", "smallest", "likely", "seen in"), [
            (limit.effect, "not seen" if limit.size is None else f"{limit.size:.3g} {limit.unit}".rstrip(),
             f"{limit.likely[0]:.3g} … {limit.likely[1]:.3g}", limit.signal or "–") for limit in found.limits]),
        *(Paragraph(f"{limit.effect} looks like {', '.join(limit.like)}.") for limit in found.limits if limit.like),
        Paragraph(f"Not seen by any signal: {', '.join(found.blind)}.") if found.blind else "",
        AnswerTable("signals", ("signal", "unit", "floor"), [
            (name, row["unit"], row["floor"]) for name, row in found.signals.items()], ".3g")])

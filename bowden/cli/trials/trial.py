"""`bowden trial`, `verify`: an experiment, recorded in one MCAP file, or run twice to judge a bench model."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from bowden import output_files
from bowden.bench import buses, configuration
from bowden.cli import ending, options, terminal
from bowden.cli.app import app
from bowden.cli.options import Bus, SimulatedOptions, StrideOptions, WalkOptions, WatchOptions, argument, option
from bowden.cli.terminal import AnswerTable, CommandAnswer, Words
from bowden.deferred import on_first_use
from parameters import InputError
from physics.effects.separating_experiments import SCRIPTED

with on_first_use():
    from bowden.bench import light_imports
    from bowden.live import feeds
    from bowden.models import logbook_entries
    from bowden.pages import figures
    from bowden.trials import experiment as experiments
    from bowden.trials import repeated_motion, session
    from bowden.watch import file_watch, watch_process
    from trial import signals


@app.command(example="bowden trial --peak 40 --cycles 3 -o trial.mcap")
def trial(
    output: Annotated[Path, options.new_file("File to write.", "a trial", ".mcap")],
    walk: WalkOptions, strides: StrideOptions, knee: options.Knee = None, desired: options.Desired = None,
    calibration: options.Calibration = None,
    controller_model: Annotated[Path | None, option(
        "Bench model whose effects the controller compensates.", "FILE")] = None,
    experiment: Annotated[str | None, option(
        f"Experiment in place of the gait, to separate effects: {', '.join(SCRIPTED)}; or repeat, with --motion-of.",
        "NAME", autocompletion=options.experiments)] = None,
    motion_of: Annotated[Path | None, option(
        "Repeat the rope and knee motion of this recorded trial, with its gait and settings (--experiment repeat).",
        "FILE")] = None,
    dry_run: Annotated[bool, option("Everything on the bus, drives never enabled.")] = False,
    homing_n: options.HomingForce = None, *, rate: options.Rate = None, simulated: SimulatedOptions, reached: Bus,
    monitor: options.SafetyMonitor = None, picture: options.Picture = None,
    web: Annotated[str | None, option("Live page with a stop button; port 0: a free one.", "[HOST:]PORT")] = None,
    logbook: options.Logbook = None, label: options.Session = None, watched: WatchOptions,
    overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Run one experiment and record it.

    --web shows it while it runs, with a button for the safe stop; the address goes to stderr. --watch diagnoses it
    while it runs, in a separate process.
    """
    light_imports.load()
    own = {"--knee": knee, "--desired": desired, "--calibration": calibration, "--controller-model": controller_model}
    repeated_motion.refuse_beside(motion_of, experiment, {
        **own, **options.spelled(walk, strides), "--dry-run": dry_run or None, "--homing-n": homing_n})
    sections = reached.sections(rate)
    sections["network"] = configuration.with_monitor(sections["network"], monitor)
    sections["homing"] = configuration.homing(sections["homing"], homing_n)
    entered = session.entered(sections, logbook, reached.config)
    desired = session.desired_file(desired)
    bench = watched.bench(entered)
    chosen = reached.chosen(simulated)
    if entered is not None:
        label = logbook_entries.label(label, chosen)
    if motion_of is not None:
        prepared = repeated_motion.prepared(motion_of, sections, chosen)
    else:
        sections["walk"] = strides.walk(sections["walk"], simulated.seed)
        sections["gait"] = walk.gait(sections["gait"])
        prepared = session.prepare_gait(
            sections, calibration, chosen, peak_given=walk.peak is not None, period_given=walk.period is not None,
            settle_given=walk.settle is not None, knee=knee, desired=desired, dry_run=dry_run,
            controller_model=controller_model, script=experiment, progress=terminal.TERMINAL)
    result = _performed(prepared, sections["network"], output, picture, web, bench, chosen, overwrite=overwrite)
    if entered is not None and label is not None and result["trial"] is not None:
        with terminal.waiting("entering the trial in the logbook"):
            result["logbook"] = logbook_entries.entered(
                entered, Path(result["trial"]), label, result)
    return CommandAnswer(
        result, _words(result, picture, chosen.in_words, entered, dry_run=dry_run,
                       with_end=sections["network"].bench.measures_end),
        ending.status_of(result["stop_reason"]))


def _performed(prepared: session.PreparedTrial, network: Any, output: Path, picture: Path | None, web: str | None,
               bench: file_watch.WatchedBench | None, chosen: buses.BusSettings, *, overwrite: bool) -> dict[str, Any]:
    """Run a trial with its live page and its watches; return its figures and, by path, the watches' findings."""
    with ExitStack() as opened:
        watches = {} if bench is None else {path: opened.enter_context(watch_process.beside(
            output, replace(bench, path=path or None), place, paced=chosen.simulated, shown=not terminal.quiet()))
            for path, place in zip(network.bench.path_prefixes, feeds.places(network, ("cycle",)), strict=True)}
        page = None if web is None else opened.enter_context(feeds.of_trial(
            web, output.name, network, lambda url: terminal.remark(f"live page: {url}")))
        if page is not None:
            for watch in watches.values():
                watch.show = page.suspected
        result = session.perform(
            prepared, output, picture, overwrite=overwrite, announce="" if terminal.quiet() else chosen.announced(),
            progress=terminal.Terminal(shown=not watches),
            watch=[*([] if page is None else [page]), *watches.values()])
        for watch in watches.values():
            with terminal.fitting("diagnosing the whole trial"):
                watch.conclude()
        if watches:
            found = {path: watch.as_json() for path, watch in watches.items()}
            result["watch"] = found.get("", {"paths": found})
    return result


def _words(result: dict[str, Any], picture: Path | None, bus: str, logbook: Path | None, *, dry_run: bool,
           with_end: bool) -> Words:
    if result["trial"] is None:
        yield f"Stopped before the first control cycle, {bus}: {result['stop_reason']}; nothing was recorded."
        return
    for path, watch in result.get("watch", {}).get("paths", {"": result.get("watch")}).items():
        if watch is not None:
            yield _words_of_watch(path, watch)
    yield from _tables(result, dry_run=dry_run)
    if not with_end:
        yield "No figures by the END sensor: the declared bench has no END load cell."
    ratio = result["wall_s"] / result["simulated_s"] if result["simulated_s"] else None
    yield AnswerTable("bus", ("figure", "value"), [
        ("load, measured (%)", result["bus_load_percent"]),
        ("load, computed bound (%)", result["bus_load_bound_percent"]),
        ("missed cycles", result["missed_cycles"]),
        ("stale inputs", result["stale_inputs"]),
        ("wall seconds per simulated second", terminal.number(ratio, ".3f")),
    ])
    if result["stop_reason"]:
        yield f"Stopped: {result['stop_reason']}"
    yield f"Trial: {result['trial']}" + (f"   picture: {picture}" if picture else "") + f"   {bus}"
    if "logbook" in result:
        kept = result["logbook"]
        yield (f"Logbook: {logbook}, trial {kept['trial']}, session {kept['session']}"
               + ("" if kept["fitted"] else f"; not fitted: {kept['remark']}"))


def _words_of_watch(path: str, watch: dict[str, Any]) -> str:
    """Return the diagnosis of the complete trial of a force path; remark the reason for its absence."""
    found, of_path = watch["diagnosis"], f" of {path}" if path else ""
    if found is None:
        terminal.remark(f"watch: no diagnosis{of_path} of the whole trial: "
                        f"{watch['remark'] or 'the watch was ended.'}")
        return ""
    return f"Watch{of_path}: {found['verdict']}" + (f": {', '.join(found['class'])}" if found["class"] else "")


def _tables(result: dict[str, Any], *, dry_run: bool) -> Words:
    """Yield the force figures of each path, and those of strides that differ: errors of force and phase."""
    paper = {} if dry_run else {
        "relative_rmse_percent": figures.PAPER_RMSE_PERCENT.get(result["peak_n"]), "max_idle_tension_n": "< 1"}
    cycles = f"{result['cycles']} cycle{'' if result['cycles'] == 1 else 's'}"
    title = (f"{result['peak_n']:g} N, {result['period_s']:g} s, {cycles}, {result['rate_hz']} Hz, "
             f"controller {result['controller']}, calibration {result['calibration']}: {result['outcome']}")
    shown = [(f"{name}, {found['peak_n']:g} N", found) for name, found in result.get("paths", {}).items()]
    for headline, found in shown or [(title, result)]:
        yield AnswerTable(headline, ("force", "by the END sensor", "true", "paper"), [
            (f"{one.text} ({one.unit})", found[one.name], found[f"true_{one.name}"], paper.get(one.name))
            for one in signals.FORCE_FIGURES])
    if walk := result.get("walk"):
        yield AnswerTable(
            f"{walk['strides']} strides, {walk['assisted']} with force, {walk['interrupted']} interrupted, by "
            f"{walk['judged_by']}", ("relative RMSE by stride (%)", "median", "95 %", "worst"), [
                (name, *(walk[key][part] for part in ("median", "percentile_95", "worst")))
                for name, key in (("against the force asked for, at the felt phase", "rmse_percent"),
                                  ("against the desired force at the true phase", "true_phase_rmse_percent"))])
        yield (f"Phase: {terminal.number(walk['phase_error_rms_percent'])} % of the gait rms; largest END at idle "
               f"{terminal.number(walk['idle_n'])} N; longest time with more than 3 N off phase "
               f"{terminal.number(walk['off_phase_ms'])} ms")


@app.command(example="bowden verify extended.toml --plant-model bench.toml --cycles 4 -o verify.mcap")
def verify(
    model: Annotated[Path, argument("EXTENDED", "extended.toml of bowden diagnose -o.")],
    output: Annotated[Path, option(
        "Trials to write: FILE with -before and -after before its suffix.", "FILE", "-o", "--output")],
    walk: WalkOptions, rate: options.Rate = None, calibration: options.Calibration = None, *,
    simulated: SimulatedOptions, reached: Bus, path: options.ForcePath = None, overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Measure what compensation of named effects gains in the control loop.

    One experiment twice on a bench, without and with compensation of the effects in EXTENDED.  Of several force paths
    EXTENDED has one file each, such as extended.left.toml; a path without one is not compensated.

    The controller is the extended one unless another is named.
    """
    sections = reached.sections(rate)
    sections["gait"] = walk.gait(sections["gait"], controller="extended")
    chosen = reached.chosen(simulated)
    files = {name: output.with_name(f"{output.stem}-{name}{output.suffix}") for name in ("before", "after")}
    names = [one.name for one in sections["network"].bench.force_paths]
    if (path is not None or len(names) > 1) and path not in names:
        raise InputError(f"--path {path or 'is missing'}: name the force path that is judged, of {', '.join(names)}.")
    output_files.refuse_ending(output, ".mcap", what="a trial")
    output_files.refuse(files.values(), overwrite=overwrite, inputs=[
        model, calibration, reached.config, simulated.plant_model])
    prepared = {
        name: session.prepare_gait(sections, calibration, chosen, peak_given=walk.peak is not None,
                                   period_given=walk.period is not None,
                                   controller_model=model if name == "after" else None) for name in files}
    figures = {name: session.perform(prepared[name], file, overwrite=overwrite, progress=terminal.TERMINAL,
                                     announce="" if terminal.quiet() else f"{name}, bench on {chosen.in_words}.")
               for name, file in files.items()}
    extended = prepared["after"].paths.get(path or "", prepared["after"].experiment)
    figures = {name: one | one.get("paths", {}).get(path, {}) for name, one in figures.items()}
    judged, gain = experiments.gained(figures["before"], figures["after"])
    result: dict[str, Any] = {
        "controller_model": str(model), "effects": {name: dict(of) for name, of in extended.known.items()},
        "terms": [term.equation for term in extended.terms], "judged_by": judged, "gain_percent": gain, **figures}
    true = judged.startswith("true_")
    changes = ", ".join([*result["effects"], *result["terms"]]) or "no effect"
    return CommandAnswer(result, [
        AnswerTable(
            f"{changes}: END {'true' if true else 'by its sensor'}, controller {figures['after']['controller']}",
            ("END", "uncompensated", "compensated"), [
                (f"{one.text} ({one.unit})", *(found["true_" * true + one.name] for found in figures.values()))
                for one in signals.FORCE_FIGURES]),
        f"Gain in relative RMSE: {terminal.number(gain, '.1f')} %",
        *(f"Trial {name}: {one['trial']}" + (f", stopped: {one['stop_reason']}" if one["stop_reason"] else "")
          for name, one in figures.items())], max(ending.status_of(one["stop_reason"]) for one in figures.values()))

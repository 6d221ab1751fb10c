"""A trial as one HTML page: identity, figures, force, motion, timing, bus, events, attachments.

The report shows recorded data and computes its figures by `metrics` alone; missing data are named.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

from trial import metrics, read
from trial.read import Extent, TrialFile
from trial.report import sections
from trial.report.overview import BINS, PHASE_BINS, Overview, TrialSetting, known, overview, setting, unknown
from trial.report.page import UNKNOWN, Cell, Page, Tile, number
from trial.report.sections import FrameBits
from trial.report.words import folded, quantity, shown, words

FIGURES = (
    ("relative_rmse_percent", "%", "relative RMSE of END, whole gait cycles, by the peak"),
    ("relative_rmse_window_percent", "%", "the same within 10…30 % of gait"),
    ("max_idle_tension_n", "N", "largest END tension while none is wanted"),
    ("peak_jump_n", "N", "largest jump of END over 20 ms at the peak"),
)
NEEDED = metrics.NEEDED
SAID = ("outcome", "stop_reason", "warning")  # of the result, said above the others
FOLDED = ("bench.toml", "calibration.toml", "packages.txt")  # attachments in this order, then the others


def write(
    trial: TrialFile, path: str | Path, frame_bits: FrameBits, *, published: Mapping[str, str] | None = None,
    bound_percent: float | None = None, overwrite: bool = False, progress: Callable[[float], None] = lambda share: None,
) -> int:
    """Write the report of `trial`, of all its force paths, as one HTML file; returns its bytes. Raises `InputError`.

    `published` are published figures by name, shown for comparison; `bound_percent` is the bus load computed
    beforehand; `progress` receives the share done, 0 … 1.
    """
    page = build(trial, frame_bits, published or {}, bound_percent, progress)
    return page.write(path, overwrite=overwrite)


def build(
    trial: TrialFile, frame_bits: FrameBits, published: Mapping[str, str], bound_percent: float | None,
    progress: Callable[[float], None] = lambda share: None,
) -> Page:
    """Return the page of a trial; of a table that was imported, without what only a bus can show."""
    judged, page = setting(trial), _head(trial)
    frames = sum(map(len, trial.frame_blocks()))
    view = overview(trial, judged)
    parts: tuple[Callable[[], None], ...] = (
        *_signals(page, trial, view, frames, published),
        lambda: sections.timing(page, view, judged, on_bus=bool(frames)),
        lambda: sections.load(page, trial, frame_bits, bound_percent),
        lambda: _events(page, trial, frames),
        lambda: _carried(page, trial),
        lambda: _reading(page, view.extent),
    )
    for done, part in enumerate(parts, start=1):
        part()
        progress(done / len(parts))
    return page


def _signals(
    page: Page, trial: TrialFile, view: Overview, frames: int, published: Mapping[str, str]
) -> list[Callable[[], None]]:
    """Return the functions that add summary, force, motion and other signals to a page, of each force path."""
    parts: list[Callable[[], None]] = []
    for name in read.path_names(trial) or ("",):
        one = read.one_path(trial, name) if name else trial
        judged = setting(one)
        parts += _of_path(page, one, overview(one, judged) if name else view, judged, frames if one.has_frames else 0,
                          f"{name}: " if name else "", published)
    return parts


def _of_path(
    page: Page, one: TrialFile, view: Overview, judged: TrialSetting, frames: int, prefix: str,
    published: Mapping[str, str],
) -> list[Callable[[], None]]:
    def begin() -> None:
        page.prefix = prefix

    def end() -> None:
        page.prefix = ""

    return [begin, lambda: _summary(page, one, view, judged, frames, published),
            lambda: _strides(page, one, judged), lambda: sections.force(page, one, view, judged),
            lambda: sections.motion(page, view.drawn), lambda: sections.others(page, view.drawn), end]


def _head(trial: TrialFile) -> Page:
    metadata, result = trial.metadata, trial.result
    title = " ".join(("Trial", trial.path.name))
    bus = metadata.get("bus", "")
    where = "SIMULATED bench" if bus == "SIMULATED" else f"bus {bus}" if bus else ""
    parts = [where, metadata.get("experiment", ""), _of(metadata, "peak_n", "N"), _of(metadata, "period_s", "s"),
             _of(metadata, "cycles", "gait cycles"), _of(metadata, "rate_hz", "Hz"),
             f"controller {metadata['controller']}" if "controller" in metadata else "",
             f"calibration {metadata['calibration']}" if "calibration" in metadata else "",
             f"imported from {metadata['imported_from']}" if "imported_from" in metadata else ""]
    outcome = "no result" if result is None else str(result.get("outcome", "recorded"))
    kind = {"completed": "good", "stopped": "bad", "no result": "warn"}.get(outcome, "plain")
    return Page(title, " · ".join(part for part in parts if part), badge=(outcome, kind))


def _of(metadata: Mapping[str, str], name: str, unit: str) -> str:
    return f"{metadata[name].removesuffix('.0')} {unit}" if name in metadata else ""


def _summary(
    page: Page, trial: TrialFile, view: Overview, judged: TrialSetting, frames: int, published: Mapping[str, str]
) -> None:
    page.section("Summary")
    result = trial.result or {}
    if result.get("stop_reason"):
        page.text(f"Stopped: {result['stop_reason']}", "warning")
    if result.get("warning"):
        page.text(f"Warning: {result['warning']}", "warning")
    if trial.result is None:
        page.text("The recording has no result: it was cut off, or is not finished.", "warning")
    if trial.recovered is not None:
        page.text("Recovered from a torn recording; control cycles may be missing.", "warning")
    _figures(page, trial, view, judged, published)
    rows, first_ns, last_ns, _ = view.extent
    seconds = (last_ns - first_ns) / 1e9 if rows else None
    facts = {**trial.metadata, **{name: value for name, value in result.items() if name not in SAID}}
    counts = {"control cycles": rows, "CAN frames": frames, "events": len(trial.events)} if frames else {"rows": rows}
    page.facts({**{name: _cell(value) for name, value in shown(facts).items()}, **counts,
                "recorded time": quantity(seconds, "s")})
    rest = folded(facts)
    if rest:
        page.attachment("commit, digests and homing", "".join(f"{name}: {_cell(one)}\n" for name, one in rest.items()))
    missing = unknown(view.drawn)
    if missing:
        page.text(f"Not in this trial: {', '.join(dict.fromkeys(map(words, missing)))}.", "note")


def _cell(value: object) -> Cell:
    if isinstance(value, Mapping):
        return ", ".join(f"{str(name).replace('_', ' ')} {_cell(one)}" for name, one in value.items()) or "none"
    if isinstance(value, list) and not value:
        return "none"
    if isinstance(value, list):
        return ", ".join(number(one) if isinstance(one, float) else str(one) for one in value)
    return value if isinstance(value, str | int | float | None) else str(value)


def _figures(
    page: Page, trial: TrialFile, view: Overview, judged: TrialSetting, published: Mapping[str, str]
) -> None:
    lacking = [name for name in NEEDED if known(view.drawn, name) is None]
    if lacking or judged.peak_n is None or judged.rate_hz is None or not judged.cycles:
        unknown_names = ", ".join(map(words, lacking)) or "peak, rate or gait cycles"
        page.text(f"No figures of force: {unknown_names} not known.", "note")
        return
    found = metrics.figures_of_blocks(
        lambda: (block.columns for block in trial.blocks(NEEDED)), peak_n=judged.peak_n, rate_hz=judged.rate_hz,
        cycles=judged.cycles, settle=judged.settle)
    page.tiles([Tile(number(found[name], 3), unit if found[name] is not None else "",
                     text, f"paper: {published[name]}" if name in published else "")
                for name, unit, text in FIGURES])
    last = judged.cycles - 1
    counted = f"Gait cycle {last} counts" if judged.settle == last else f"Gait cycles {judged.settle} to {last} count"
    page.text(f"{counted}, peak {number(judged.peak_n)} N; END as "
              "recorded at the latch that holds the desired force; in idle and at the peak after a 20 Hz zero-phase "
              "low-pass."
              + (f" Read off the columns: {', '.join(judged.read_off)}." if judged.read_off else ""), "note")


def _strides(page: Page, trial: TrialFile, judged: TrialSetting) -> None:
    """Add a table of strides that differ; nothing for a trial of one that repeats."""
    if set(metrics.STRIDE_COLUMNS) - set(trial.units) or judged.peak_n is None or judged.rate_hz is None:
        return
    columns = metrics.stride_columns(block.columns for block in trial.blocks(metrics.STRIDE_COLUMNS))
    found = metrics.stride_figures(columns, peak_n=judged.peak_n, rate_hz=judged.rate_hz, settle=judged.settle)
    page.section("Strides")
    page.text(f"By the {found['judged_by']}; relative RMSE by the peak. The first {judged.settle} count in no figure.",
              "note")
    page.table(("stride", "kind", "period (s)", "RMSE, force asked for (%)", "RMSE, true phase (%)",
                "phase error, rms (%)", "largest END at idle (N)", "more than 3 N off phase (ms)"),
               [tuple(one[name] for name in metrics.STRIDE_TABLE) for one in found["by_stride"]], tall=True)


def _events(page: Page, trial: TrialFile, frames: int) -> None:
    if not trial.events and not frames:
        return
    page.section("Events")
    if not trial.events:
        page.text("No events were recorded.", "note")
        return
    first = trial.extent.first_ns if trial.extent.rows else trial.events[0].time_ns
    page.table(("time (s)", "kind", "source", "text"), [
        (f"{(event.time_ns - first) / 1e9:.6f}".replace("-", "−"), event.kind, event.source, event.text)
        for event in trial.events], tall=len(trial.events) > 15)


def _carried(page: Page, trial: TrialFile) -> None:
    if not trial.attachments and not trial.metadata.get("commit"):
        return
    page.section("Configuration, calibration, software")
    if trial.metadata.get("commit"):
        page.facts({"commit": trial.metadata["commit"]})
    names = [name for name in FOLDED if name in trial.attachments]
    for name in [*names, *(name for name in trial.attachments if name not in names)]:
        page.attachment(name, trial.attachments[name].decode(errors="replace"))
    if not trial.attachments:
        page.text("The trial carries no files.", "note")


def _reading(page: Page, extent: Extent) -> None:
    page.section("How to read it")
    rows, first_ns, last_ns, _ = extent
    bins = BINS
    if rows > 2 * bins:
        span = (last_ns - first_ns) / 1e6 / bins
        thinning = (f"Plots over time draw the least and greatest of every {span:.3g} ms ({rows} rows in {bins} bins): "
                    "no peak is lost; order within a bin and gaps shorter than it are.")
    else:
        thinning = f"Plots over time draw every one of the {rows} rows."
    page.text(f"{thinning} Against the phase, a gait cycle is drawn by least and greatest of up to "
              f"{PHASE_BINS} bins. Figures are computed from every row.", "note")
    page.text(f"A name's column in the file is in its tooltip, SI there; {UNKNOWN} is unknown. Time counts from the "
              "first control cycle, so bring-up is negative. A line breaks where rows are missing.", "note")

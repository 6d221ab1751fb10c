"""Selection of the terms that extend the model: evidence proposes them, held-out cycles decide."""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Final

import numpy as np

from diagnosis.compared_signals import Figures
from diagnosis.evidence.decision import DOUBTED, SET_SHARE, departure
from diagnosis.evidence.held_out import HeldOut, blocks_of
from diagnosis.laws.law_result import Laws, Picture
from diagnosis.laws.law_search import MOST_TERMS, WORSE, Candidate, LawSearch
from estimation.data.table import Table
from estimation.likelihood_data import Recording
from estimation.posterior import PosteriorMode, SessionData
from estimation.reference_fit import ReferenceFit
from physics.effects.hypotheses import Variant
from physics.laws import Array
from physics.terms import MODULATIONS

CLOSE_CALL: Final = 0.8
"""Evidence, relative to the best candidate's, from which fits decide: a screen's is linear, and off by as much."""
TRIED: Final = 3
"""Candidates for the first term that are fitted and tested on held-out cycles; of a further term the foremost alone,
since each of them costs another screen for swaps."""


def discover(reference: ReferenceFit, observed: SessionData, tables: Sequence[Table], references: Sequence[Recording],
             variants: Sequence[Variant] = ()) -> Laws:
    """Return the terms that extend the model of `reference` in trials of one session.

    `observed`: the trials' data; `tables`: the same trials; `references`: the reference trials; `variants`: effects
    that stay beside the terms.  A term is kept if it worsens no signal on held-out cycles (`worse`), and gains on them.
    So is a first one that brings the session's constants back into their scatter and halves their departure
    (`DOUBTED`).  The first term that is not kept ends the search.
    """
    blocks = blocks_of(tables, observed.trials)
    search = LawSearch(observed, reference.prior_of(observed), reference, blocks, references, variants)
    fault, runners = "", list[Candidate]()
    fits = [(list[Candidate](), search.base)]  # terms and mode with none, one, … of them

    @cache
    def without(terms: int, simulates: bool) -> Array:
        return search.predicted(*fits[terms], simulates)

    def figures(before: Array, after: Array) -> dict[str, Figures]:
        return HeldOut(observed, reference.missed(observed), before, after, blocks).figures(reference)

    def reason_against(more: list[Candidate], there: PosteriorMode) -> tuple[str, bool]:
        """Return why terms are not kept, "" if they are, and whether they bring the session back into its scatter."""
        count = len(more) - 1
        before, after = without(count, False), search.predicted(more, there)
        if worse(figures(before, after), observed.model.judged):
            before, after = without(count, True), search.predicted(more, there, True)
        errors, least = figures(before, after), search.errors.least_falls(before - after)
        # where the model is wrong, any bump that fits its error takes a little of the departure
        harm = worse(errors, observed.model.judged)
        back = not count and not harm and departure(observed, there) <= min(
            DOUBTED, search.departed / DOUBTED) and search.departed > DOUBTED
        return harm or unconfirmed(errors, least), back

    while len(fits) <= MOST_TERMS:
        chosen, at = fits[-1][0], fits[-1][1] if fits[-1][0] else search.first
        offers = search.further(chosen, at)
        # the evidence of a screen is linear, so that fits decide between nearly equal candidates
        near = [c for c in offers if c.nats >= CLOSE_CALL * offers[0].nats][:1 if chosen else TRIED]
        offered = [(more, search.fitted(more, at if chosen else None)) for more in (
            search.swapped([*chosen, offer], at) if chosen else [offer] for offer in near)]
        kept: tuple[list[Candidate], PosteriorMode] | None = None
        for fit in sorted(offered, key=lambda fit: -fit[1].log_evidence):
            reason, back = reason_against(*fit)
            if not reason:
                kept = fit
                break
            fault, kept = fault or reason, kept or (fit if back else None)
        if kept is None:
            break
        more, fault = kept[0], ""
        runners = runners or [c for c in offers if c.shape != more[0].shape and c.nats > SET_SHARE * offers[0].nats]
        # once more, with the columns linearised there: a coefficient is relative to the constants of its own session
        fits.append((more, search.fitted(*kept)))
    chosen, at = fits[-1]
    session = without(0, bool(chosen))
    return Laws(search.terms(chosen, at), [c.nats for c in chosen], figures(
        session, search.predicted(chosen, at, True) if chosen else session),
                [(f"{c.carrier} × {c.modulation}", c.nats) for c in runners] if chosen else [], search.size, fault,
                [_picture(search, chosen, at, k) for k in range(len(chosen))])


def worse(errors: Mapping[str, Figures], judged: Sequence[str]) -> str:
    """Return a sentence on a signal whose error on held-out cycles grows by more than `WORSE` with a term, else "".

    Of a signal that is not `judged` whole cycles must confirm it: a session without the term bends the constants of the
    drive, too, and may predict its force better by chance.
    """
    return next((f"{name} is predicted worse on held-out cycles" for name, f in errors.items()
                 if (f.rmse_after or 0.0) > WORSE * (f.rmse_session or 0.0)
                 and (name in judged or (f.high or 0.0) < 100.0 * (1.0 - WORSE))), "")


def unconfirmed(errors: Mapping[str, Figures], least: Mapping[str, float]) -> str:
    """Return why a term does not gain, by errors on held-out cycles without it (`session`) and with it; "" if it does.

    `least`: fall of the squared error that a term must exceed in one judged signal, N².
    """
    gaining = {name: errors[name] for name in least if (errors[name].low or 0.0) > 0.0}
    if not gaining:
        return "no gain on held-out cycles that whole cycles confirm"
    if all((f.rmse_session or 0.0)**2 - (f.rmse_after or 0.0)**2 < least[name] for name, f in gaining.items()):
        return "the best term gains less than the variance of model error, and of discrepancy where it repeats"
    return ""


def _picture(search: LawSearch, chosen: Sequence[Candidate], at: PosteriorMode, k: int) -> Picture:
    """Return residual and law of term `k` for the judged output that it changes most."""
    slopes = search.sensitivities(at)
    columns, _ = search.columns(slopes, chosen)
    counts = np.cumsum([0, *(MODULATIONS[c.modulation].components for c in chosen)])
    weights = at.x[at.x.size - counts[-1]:]
    part = columns[:, counts[k]:counts[k + 1]] @ weights[counts[k]:counts[k + 1]]
    trial = search.observed.trials[0]
    first = next(rows for _, rows in search.observed.each(part))
    rest = next(rows for _, rows in search.observed.each(at.residual + part))
    laws, left = (search.observed.model.errors(trial, rows) for rows in (first, rest))
    name = max((n for n in search.observed.model.judged if n in laws), key=lambda n: float(np.std(laws[n])))
    depends = MODULATIONS[chosen[k].modulation].depends
    values = getattr(search.modulated[0].of(chosen[k].carrier), depends if depends != "nothing" else "time_s")
    return Picture(depends if depends != "nothing" else "time_s", name, search.observed.model.signals[name],
                   trial.binned(values), left[name], laws[name])

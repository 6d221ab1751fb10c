"""Evidence of the catalogue's effects in a trial, on the posterior of `estimation`.

    ln B(effect) = ln p(y | effect) − ln p(y | reference condition)      Laplace approximation at the modes.

An effect adds prior variance along directions of the constants (`physics.effects.hypotheses`).  Modules, lowest first.

    session_change         evidence averaged over a further change of the discrepancy
    hypothesis_search      hypotheses about one trial
    decision               verdict
    held_out               errors on held-out cycles
    identical_motion       difference from a reference trial of the same motion
    evidence_finder        from trials to findings
    experiment_prediction  choice of the next experiment
"""

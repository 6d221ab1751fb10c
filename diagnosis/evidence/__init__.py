"""Diagnosis by evidence: one forward model, a hierarchical Gaussian prior, and a log Bayes factor for each effect.

Equations, with y the measured outputs of a trial, m its measured motion, q the bench constants:

    y = f(q + δ; m) + Φ(m)·(c + d) + ε          q bench, δ session, c discrepancy, d its session part, ε noise
    p(q, c | reference trials)                   posterior of the bench, Gaussian about the fitted mode
    ln B(effect) = ln p(y | effect) − ln p(y | reference condition)      Laplace approximation at the modes

An effect adds prior variance along directions of q (`physics.effects.hypotheses`).  Modules, lowest first:

    likelihood_data        signals on one time grid
    forward_model          interface of a forward model
    outputs, path_model    forward model of the bench
    rig_model              forward model of another rig
    posterior              modes and evidence
    reference_fit          fit of the reference trials
    hypothesis_search      hypotheses about one trial
    decision               verdict
    held_out               errors on held-out cycles
    evidence_finder        from trials to findings
    experiment_prediction  choice of the next experiment
"""

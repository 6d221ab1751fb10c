"""Diagnosis by evidence: one forward model, one hierarchical Gaussian, one Bayes factor for each effect.

Equations, with y the measured outputs of a trial, m its measured motion, q the bench constants:

    y = f(q + δ; m) + Φ(m)·(c + d) + ε          q bench, δ session, c discrepancy, d its session part, ε noise
    p(q, c | reference trials)                   posterior of the bench, Gaussian about the fitted mode
    ln B(effect) = ln p(y | effect) − ln p(y | reference condition)      Laplace approximation at the modes

An effect adds prior variance along directions of q (`physics.effects.hypotheses`).  Modules, lowest first:
`likelihood_data` (signals on one grid), `forward_model` (what a model has), `outputs` and `path_model` (the bench's),
`posterior` (modes and evidence),
`reference_fit` (fit of the reference trials), `hypothesis_search` (hypotheses of one trial), `decision` (verdict),
`evidence_finder` (trials in, findings out).
"""

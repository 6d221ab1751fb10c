"""Terms that extend the forward model where no effect of the catalogue explains a trial.

The model, with y the measured data of a trial:

    y = f(q + δ; m) + Φ(m)·(c + d) + Σ aⱼ·∂f/∂qⱼ·mⱼ(t) + ε.

A term is a sensitivity of the fitted model ∂f/∂q times a modulation m(t) (`physics.terms`), so that it keeps a unit and
a part of the bench.  Modules, lowest first.

    library      candidate terms: carriers × modulations
    model_error  errors that repeat or last
    law_search   selection by evidence, refinement, held-out errors
    law_result   terms, three errors, runners-up
    law_findings confirmation on held-out cycles
"""

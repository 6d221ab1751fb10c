"""Estimation of a bench's constants: recordings and a forward model in, a posterior out.

    y = f(q + δ; m) + Φ(m)·(c + d) + ε          q bench, δ session, c discrepancy, d its session part, ε noise
    p(q, c | reference trials)                   posterior of the bench, Gaussian about the fitted mode

y: measured outputs of a trial, m: its measured motion.  Modules, lowest first:

    transfer               fits of the transfer model that controllers invert
    data                   reading of trials and tables, checks for contradictions
    likelihood_data        signals on one time grid
    forward_model          interface of a forward model
    outputs, path_model    forward model of the bench
    rig_model              forward model of another rig
    posterior              modes and evidence of one trial
    reference_fit          reference condition of a bench: posterior, discrepancy, noise
    joint_fit              joint fit of the reference trials
    population_reference   reference condition without reference trials
    stored_fit             reference posterior as bytes
    fitted_quantities      quantities that follow from a fit's constants, with their 1σ
    linear_sums            sums of linearised trials: constants, discrepancy, effects
    running_evidence       evidence of effects by gait cycle, while a trial runs
    sessions               sessions of a bench over months: scatter, a step or a ramp of an effect
    simulation             many-segment simulation under the measured motion of a trial
    simulation_fit         its parameters, from the fitted force path
    rig_fit                constants of another rig
    bench_fit              the file of `bowden fit`

Start reading in `forward_model`, `posterior` and `joint_fit`.
"""

"""Fits of the transfer model START → END that controllers invert: to loops, to a homing, to gait trials.

    homing_fit           session deviations from one pull and release
    jackknife            intervals by leaving out laps
    calibration_fit      scalars of a calibration from experiments
    discrepancy_fit      error of END beyond the scalars, by motion and load
    trial_calibration    both from trials of any motion
"""

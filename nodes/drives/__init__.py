"""CiA 402 drives: state machine, axes, modes, homing, and the servo and knee drives of the bench."""

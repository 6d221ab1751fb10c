"""Controllers: pure functions from what START, encoders and knee say to targets for both drives."""

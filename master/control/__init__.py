"""Controllers: pure functions from START, encoders and knee to targets for both drives."""

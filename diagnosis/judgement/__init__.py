"""The judgement: which effects are named, which cannot be told apart, and what another experiment would show."""

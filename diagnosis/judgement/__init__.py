"""Judgement of a search: effects that are named, the ambiguity set, and the experiment that would split it."""

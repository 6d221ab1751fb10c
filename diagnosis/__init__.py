"""Diagnosis of a bench or rig from measured trials: which effects the simulation lacks, their sizes, and the error
that remains with them.

Equations and effects come from `physics`; no effect is named in the code of this package.  Every estimate has a 95 %
interval, every error is computed on data outside the fit, and effects that the data do not separate are reported as
an ambiguity set.

Start reading in `diagnosis.finder`, then `diagnosis.evidence`; `docs/diagnosis.md` shows what it answers.
"""

"""Generator of docs/effects.md from the catalogue: `python -m tests.physics.effects_page [FILE]`.

The page contains the declarations and nothing else.
"""

from __future__ import annotations

import sys
from pathlib import Path

from physics.effects.catalogue import CATALOGUE, Effect, EffectParameter
from physics.effects.separating_experiments import EXPERIMENTS

HEAD = """# Effects

For whoever reads an effect's name: what can make a bench differ from its simulation.
Generated from `physics/effects/declarations.py` by
`python -m tests.physics.effects_page docs/effects.md`; change the declarations, not this page. Values are SI.
*Likely* is where a search starts; *bounds* are hard. *Neutral* is the value at which an effect is absent, — where
only a calibration knows the healthy one.
"""


def _number(value: float) -> str:
    return f"{value:.4g}".replace("-", "−")


def _parameter(p: EffectParameter) -> str:
    unit = p.unit or "1"
    neutral = "—" if p.neutral is None else _number(p.neutral)
    likely, bounds = (f"{_number(a)} … {_number(b)}" for a, b in (p.likely, (p.low, p.high)))
    return f"| `{p.name}` | {p.text} | {unit} | {likely} | {bounds} | {neutral} |"


def _effect(effect: Effect) -> str:
    rows = "\n".join(_parameter(p) for p in effect.parameters)
    rivals = ", ".join(f"`{name}`" for name in effect.rivals) or "nothing"
    sets = ", ".join(f"`{target}`" for target in effect.forward)
    return (
        f"## `{effect.name}`\n\n{effect.words}\n\n"
        f"- site: {effect.site}\n- law: {effect.law}\n- source: {effect.source}\n- shows as: {effect.signature}\n"
        f"- confused with: {rivals}; separated by `{effect.experiment}`\n"
        f"- in the plant model: {sets}\n\n"
        f"| parameter | meaning | unit | likely | bounds | neutral |\n|---|---|---|---|---|---|\n{rows}\n"
    )


def _index() -> str:
    rows = (f"| {site} | {', '.join(f'[`{e.name}`](#{e.name})' for e in CATALOGUE.values() if e.site == site)} |"
            for site in dict.fromkeys(e.site for e in CATALOGUE.values()))
    return "| site | effects |\n|---|---|\n" + "\n".join(rows) + "\n"


def _experiments() -> str:
    rows = (
        f"| `{e.name}` | {e.motion} | {e.reads} | {e.by_hand or '—'} |" for e in EXPERIMENTS.values()
    )
    return "## Experiments\n\n| name | motion | look at | by hand |\n|---|---|---|---|\n" + "\n".join(rows) + "\n"


def page() -> str:
    """Return the whole page as Markdown."""
    return "\n".join([HEAD, _index(), *(_effect(e) for e in CATALOGUE.values()), _experiments()])


if __name__ == "__main__":
    Path(sys.argv[1] if len(sys.argv) > 1 else "docs/effects.md").write_text(page(), encoding="utf-8")

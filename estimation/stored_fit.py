"""Reference posterior as bytes: arrays as npz, their structure as JSON, so that a file holds no code."""

import io
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from estimation.forward_model import ForwardModel
from estimation.posterior import Gaussian, SessionDeparture
from estimation.reference_fit import Reach, ReferenceFit, Scaling
from parameters import InputError


def encoded(fit: ReferenceFit) -> bytes:
    """Return a reference posterior as bytes, without its forward model."""
    arrays: dict[str, Any] = {}

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            arrays[f"a{len(arrays)}"] = value
            return {"array": f"a{len(arrays) - 1}"}
        if is_dataclass(value):
            return {"fields": {f.name: plain(getattr(value, f.name)) for f in fields(value)
                               if f.name not in ("model", "joint_minimum", "bench_nats", "session_priors")}}
        if hasattr(value, "_asdict"):
            return {"fields": {k: plain(v) for k, v in value._asdict().items()}}
        if isinstance(value, tuple | list):
            return {"tuple": [plain(v) for v in value]}
        if isinstance(value, Mapping):
            return {"mapping": {k: plain(v) for k, v in value.items()}}
        return value

    structure = json.dumps(plain(fit))
    arrays["structure"] = np.frombuffer(structure.encode(), np.uint8)
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def decoded(content: bytes, model: ForwardModel) -> ReferenceFit:
    """Return the reference posterior of `encoded`; raises `InputError` for one that another version wrote."""
    kinds: dict[str, Any] = {"bench": Gaussian, "prior": Gaussian, "scaling": Scaling, "reach": Reach,
                             "departure": SessionDeparture}
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        held = {name: arrays[name] for name in arrays.files}

    def built(value: Any, name: str = "") -> Any:
        if not isinstance(value, dict):
            return value
        if "array" in value:
            return held[value["array"]]
        if "tuple" in value:
            return tuple(built(v) for v in value["tuple"])
        if "mapping" in value:
            return {k: built(v) for k, v in value["mapping"].items()}
        given = {k: built(v, k) for k, v in value["fields"].items()}
        return kinds[name](**given) if name else ReferenceFit(model, **{"reach": None, **given})

    try:
        made: ReferenceFit = built(json.loads(held["structure"].tobytes()))
    except (KeyError, TypeError):
        raise InputError("the reference posterior was written by another version; make a logbook anew and add the "
                         "trials.") from None
    return made

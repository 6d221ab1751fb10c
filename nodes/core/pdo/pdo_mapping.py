"""PDO mapping: which objects lie in which bits (CiA 301, 7.5.2.36 and 7.5.2.38).

The rule of this file: a mapping is judged once, by abort codes, and compiled once, into an `eds.pdo_plan.PdoPlan`.
"""

from collections.abc import Callable, Sequence
from operator import itemgetter

from eds.cia301 import Abort
from eds.datatype import Value
from eds.dictionary import Entry
from eds.pdo_plan import FIRST_OBJECT, MAX_BITS, PdoPlan, compile_plan
from nodes.core.objects import Objects
from parameters import InputError

_RPDO_ACCESS = frozenset({"wo", "rw", "rww"})
_TPDO_ACCESS = frozenset({"ro", "rw", "rwr", "const"})


def word_refused(objects: Objects, word: int, receive: bool) -> Abort | None:
    """Return the abort for one mapping word (index << 16 | sub-index << 8 | bits), None if it may be mapped."""
    at = word >> 8
    if at >> 8 >= FIRST_OBJECT:
        missing = objects.missing(at)
        if missing:
            return missing
        entry = objects.entries[at]
        if not entry.mappable or entry.access not in (_RPDO_ACCESS if receive else _TPDO_ACCESS):
            return Abort.NOT_MAPPABLE
    elif not receive or at & 0xFF:
        return Abort.NOT_MAPPABLE
    try:
        compile_plan(objects.dictionary, (word,), 0)
    except InputError:
        return Abort.NOT_MAPPABLE
    return None


def mapping_refused(objects: Objects, words: Sequence[int], receive: bool) -> Abort | None:
    """Return the abort for a whole mapping, None if it may be used."""
    for word in words:
        refusal = word_refused(objects, word, receive)
        if refusal:
            return refusal
    return Abort.PDO_LENGTH if sum(word & 0xFF for word in words) > MAX_BITS else None


def packer(plan: PdoPlan) -> Callable[[dict[int, Value]], bytes]:
    """Return the function that packs a TPDO from the values of a device."""
    pack, keys = plan.pack, plan.keys
    if not keys:
        return lambda values: pack()
    if len(keys) == 1:
        only = keys[0]
        return lambda values: pack(values[only])
    pick = itemgetter(*keys)
    return lambda values: pack(*pick(values))


def process_output(entry: Entry) -> bool:
    """Return whether an RPDO may write `entry`: it is process data then, not a parameter."""
    return entry.mappable and entry.access in _RPDO_ACCESS

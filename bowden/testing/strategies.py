"""Hypothesis strategies for PDOs and SDO conversations of a dictionary; they need `hypothesis`."""

import sys

from hypothesis import strategies as st

from bowden.testing.conversation import SdoStep
from eds.datatype import DataType, Value, encode
from eds.dictionary import Dictionary, Entry
from eds.pdo_plan import compile_plan
from parameters import InputError

LONGEST = 64
"""Length of the longest string or domain that a strategy writes, bytes."""
LARGEST_SINGLE = (2.0 - 2.0**-23) * 2.0**127
"""Largest finite REAL32."""


def values(entry: Entry) -> st.SearchStrategy[Value]:
    """Raw values that an entry can hold, within LowLimit and HighLimit."""
    kind = entry.data_type
    if kind is DataType.BOOLEAN:
        return st.integers(0, 1)
    if kind.integer:
        low = kind.low if entry.low is None else max(kind.low, entry.low)
        high = kind.high if entry.high is None else min(kind.high, entry.high)
        return st.integers(low, high)
    if kind.real:
        single = kind is DataType.REAL32
        most = LARGEST_SINGLE if single else sys.float_info.max
        return st.floats(-most if entry.low is None else entry.low, most if entry.high is None else entry.high,
                         width=32 if single else 64)
    return st.binary(min_size=kind.size or 1, max_size=kind.size or LONGEST)


def pdo_data(dictionary: Dictionary, index: int) -> st.SearchStrategy[bytes]:
    """Payloads of the PDO whose mapping object is `index` (0x1600 or 0x1A00 and on), every value within its limits.

    Raises `InputError` where the mapping is empty or unusable.
    """
    words = dictionary.mapping(index)
    if not words:
        raise InputError(f"{dictionary.path}: {index:04X} maps nothing; name a mapping object that maps objects.")
    plan = compile_plan(dictionary, words, 0)
    fields = [values(dictionary.entries[at]) for at in plan.keys]
    return st.tuples(*fields).map(lambda raw: plan.pack(*raw))


def sdo_steps(dictionary: Dictionary) -> st.SearchStrategy[SdoStep]:
    """One transfer: mostly a read or a well-formed write of an object that exists, now and then a wrong one."""
    entries = st.sampled_from(list(dictionary.entries.values()))
    reads = st.builds(lambda entry, block: SdoStep(entry.index, entry.subindex, None, block), entries, st.booleans())
    wrong = st.builds(SdoStep, st.integers(0, 0xFFFF), st.integers(0, 0xFF), st.none() | st.binary(max_size=12))
    return reads | entries.flatmap(_write) | wrong


def _write(entry: Entry) -> st.SearchStrategy[SdoStep]:
    return st.builds(lambda value, block: SdoStep(entry.index, entry.subindex, encode(entry.data_type, value), block),
                     values(entry), st.booleans())


def sdo_conversations(dictionary: Dictionary, max_size: int = 12) -> st.SearchStrategy[list[SdoStep]]:
    """Conversations of up to `max_size` steps, for `bowden.testing.conversation.converse`."""
    return st.lists(sdo_steps(dictionary), min_size=1, max_size=max_size)

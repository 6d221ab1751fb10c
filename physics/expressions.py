"""Expressions over named signals that a user writes, such as "max(tension_n - from_n, 0) / 30".

An expression is parsed and interpreted node by node: numbers, names, arithmetic, comparisons and `FUNCTIONS`.  Nothing
else of Python is reachable from it.
"""

import ast
import operator
from collections.abc import Callable, Collection, Mapping
from types import MappingProxyType
from typing import Any, Final, cast

import numpy as np

from parameters import InputError
from physics.laws import Array

Signals = Mapping[str, Any]
FUNCTIONS: Final[Mapping[str, tuple[int, Callable[..., Any]]]] = MappingProxyType({
    "abs": (1, np.abs), "sign": (1, np.sign), "sqrt": (1, np.sqrt), "exp": (1, np.exp), "log": (1, np.log),
    "sin": (1, np.sin), "cos": (1, np.cos), "tanh": (1, np.tanh), "max": (2, np.maximum), "min": (2, np.minimum)})
"""Functions of an expression, by name, with the number of their arguments."""
OPERATORS: Final[Mapping[type[ast.AST], Callable[..., Any]]] = MappingProxyType({
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: np.divide, ast.Pow: np.power,
    ast.USub: operator.neg, ast.UAdd: operator.pos, ast.Lt: np.less, ast.LtE: np.less_equal, ast.Gt: np.greater,
    ast.GtE: np.greater_equal})
LONGEST: Final = 500
"""Largest number of characters of an expression, so that no file nests deeper than the interpreter follows."""


def names_of(text: str, known: Collection[str], where: str) -> set[str]:
    """Return the names in an expression; raises `InputError` for any other text, and for names that are not `known`."""
    try:
        tree = ast.parse(text, mode="eval") if len(text) <= LONGEST else None
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        tree = None
    if tree is None:
        raise InputError(f"{where}: {text[:60]!r} is no expression of at most {LONGEST} characters; write one such as "
                         "\"max(tension_n - 20, 0) / 30\".")
    _refuse(tree.body, where)
    found = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} - FUNCTIONS.keys()
    unknown = sorted(found - set(known))
    if unknown:
        raise InputError(f"{where}: unknown name {', '.join(unknown)}; expected {', '.join(sorted(known))}.")
    return found


def _refuse(node: ast.AST, where: str) -> None:
    """Raise `InputError` for a part of an expression that is neither number, name, arithmetic nor known function."""
    allowed = ((isinstance(node, ast.Constant) and type(node.value) in (int, float))
               or isinstance(node, ast.Name)
               or (isinstance(node, ast.BinOp | ast.UnaryOp) and type(node.op) in OPERATORS)
               or (isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in OPERATORS)
               or (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords
               and len(node.args) == FUNCTIONS.get(node.func.id, (-1,))[0]))
    if not allowed:
        raise InputError(f"{where}: {ast.unparse(node)[:60]!r} is not allowed; expected numbers, signals, parameters, "
                         f"+ - * / ** < >, and {', '.join(FUNCTIONS)}.")
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.expr) and not (isinstance(node, ast.Call) and child is node.func):
            _refuse(child, where)


def compiled(text: str) -> Callable[[Signals], Array]:
    """Return an expression that `names_of` has accepted as a function of its signals and parameters; a value
    that is not finite becomes 0."""
    tree = ast.parse(text, mode="eval").body

    def value(node: Any, signals: Signals) -> Any:
        if isinstance(node, ast.Constant):
            return float(cast("float", node.value))  # `_refuse` allows int and float alone
        if isinstance(node, ast.Name):
            return signals[node.id]
        if isinstance(node, ast.UnaryOp):
            return OPERATORS[type(node.op)](value(node.operand, signals))
        if isinstance(node, ast.Call):
            return FUNCTIONS[cast("ast.Name", node.func).id][1](*(value(part, signals) for part in node.args))
        if isinstance(node, ast.Compare):
            return OPERATORS[type(node.ops[0])](value(node.left, signals), value(node.comparators[0], signals)) * 1.0
        return OPERATORS[type(node.op)](value(node.left, signals), value(node.right, signals))

    def function(signals: Signals) -> Array:
        with np.errstate(all="ignore"):
            return np.asarray(np.nan_to_num(value(tree, signals), posinf=0.0, neginf=0.0), np.float64)

    return function

"""One declaration for each parameter: default, unit, bounds, source.

The rule of this package: a number that a user may change is declared once, as a field of a frozen
dataclass made by `parameter(...)`; reading a TOML table, checking it, listing it with its unit and
writing a commented template are all derived from that declaration.  Every room may import this
package; it imports none of them.

Start reading in `parameters.declared`.
"""

from parameters.declared import Declared, InputError, Remark, apart, checked, declarations, parameter
from parameters.tables import from_table, read_toml, template

__all__ = [
    "Declared",
    "InputError",
    "Remark",
    "apart",
    "checked",
    "declarations",
    "from_table",
    "parameter",
    "read_toml",
    "template",
]
